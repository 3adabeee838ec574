"""Paired runs of contenders on the same scenarios, their metrics, statistics and report."""

"""Comparison of contenders on the same scenarios."""

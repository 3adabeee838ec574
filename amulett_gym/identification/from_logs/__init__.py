"""Identification of one device from its logs: measured trajectories to parameters with intervals."""

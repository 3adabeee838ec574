"""Measurements of speed: kernel, environments, learning."""

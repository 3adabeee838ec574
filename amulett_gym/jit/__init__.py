"""Compilation of the equations."""

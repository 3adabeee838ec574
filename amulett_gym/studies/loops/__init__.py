"""Comparison of the control loops on the paper's step."""

"""Reproduction of the paper: its published numbers, compared with ours."""

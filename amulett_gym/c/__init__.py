"""The tick in plain C, and its compilation."""

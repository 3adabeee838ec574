"""Section 2.2 of the paper: the controllers."""

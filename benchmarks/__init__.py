"""Yardsticks for the kernel's speed, used for nothing else: the same tick in C, and this machine's limits."""

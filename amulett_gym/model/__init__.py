"""The device of section 2.1 of the paper."""

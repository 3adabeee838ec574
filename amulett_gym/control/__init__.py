"""Control loops: those of section 2.2 of the paper and of the literature."""

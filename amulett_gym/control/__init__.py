"""The control loops of section 2.2 of the paper, with those of the literature."""

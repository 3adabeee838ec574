"""From data to parameters: which devices could have produced what was measured."""

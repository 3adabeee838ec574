"""Stiffness laws: anything that maps an observation to an action."""

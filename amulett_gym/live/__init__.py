"""The live twin: the simulation in a browser."""

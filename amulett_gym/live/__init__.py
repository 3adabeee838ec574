"""The live twin: the simulation in a browser, as one page that needs no server."""

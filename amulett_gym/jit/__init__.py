"""How the equations are compiled, and where the compiled code is kept."""

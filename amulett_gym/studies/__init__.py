"""Studies made with the environments: each is a folder that only the command line imports."""

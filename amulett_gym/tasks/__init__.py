"""Scenarios: setpoints, loads, pushes."""

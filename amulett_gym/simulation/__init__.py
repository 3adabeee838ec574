"""Simulation of devices in control ticks."""

"""Identification of device parameters from data."""

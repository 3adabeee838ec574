"""Searches: laws in many scenarios at once, tuned laws, the clairvoyant reference."""

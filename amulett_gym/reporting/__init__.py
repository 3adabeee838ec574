"""How everything that a person reads is written."""

"""The control tick in plain C."""

"""From the state of an episode to a picture."""

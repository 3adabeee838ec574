"""Pictures of an episode's state."""

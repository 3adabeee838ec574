"""How fast kernel, environments and learning are."""

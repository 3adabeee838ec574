"""The tick, batches of it, recorded trajectories and an independent reference."""

"""What learns: PPO, the SB3 adapter and the writing of policy bundles."""

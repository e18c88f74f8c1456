"""The simulated robot and world, and how a trajectory is executed there."""

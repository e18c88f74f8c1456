"""A network that learns from rollouts in generated scenes what the drop model gets wrong; see docs/learned-drops.md."""

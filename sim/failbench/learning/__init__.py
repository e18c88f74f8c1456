"""A network that corrects the drop model, learned from rollouts in generated scenes; see docs/learned-drops.md."""

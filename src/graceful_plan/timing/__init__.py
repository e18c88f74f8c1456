"""From paths to trajectories."""

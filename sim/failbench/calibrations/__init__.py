"""Constants of impact models, fitted to rollouts."""

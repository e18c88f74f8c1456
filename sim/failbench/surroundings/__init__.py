"""Faults of the surroundings: what happens around a healthy robot."""

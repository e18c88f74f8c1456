"""Faults of the surroundings: events around a healthy robot."""

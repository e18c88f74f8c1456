"""Faults of the robot, by category, and its reactions."""

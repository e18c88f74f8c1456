"""Bases among those who move: where and when to go."""

"""Robots that drive, on wheels that turn: what they do when they fail, and how well they follow what was planned."""

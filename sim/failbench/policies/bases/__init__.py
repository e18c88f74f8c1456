"""Bases that controllers drive, healthy and while they fail."""

"""Poses and configurations to pass on the way."""

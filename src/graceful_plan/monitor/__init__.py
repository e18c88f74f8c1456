"""Monitoring of a motion while a robot executes it, and stops that are ready when it is needed."""

"""Surroundings from sensor data."""

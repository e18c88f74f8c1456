"""Surroundings as sensors tell of them."""

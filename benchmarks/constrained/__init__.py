"""Motions under constraints: what carried vessels keep, and planning with an object upright."""

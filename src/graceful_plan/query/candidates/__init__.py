"""Timed motions that get better, and the searches, descents and timings that they come from."""

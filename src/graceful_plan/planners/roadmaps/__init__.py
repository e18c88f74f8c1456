"""Roadmaps, and graphs in general."""

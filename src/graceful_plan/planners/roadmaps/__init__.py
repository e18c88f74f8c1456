"""Roadmaps and graph search."""

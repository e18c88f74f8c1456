"""Judges of motions: exact geometry, and nothing that planners use."""

"""Whole tasks: grasps, placements, actions, and the search for the sequence of least cost."""

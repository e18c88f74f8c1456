"""Planners of the Open Motion Planning Library."""

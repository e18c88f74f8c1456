"""Planners that improve a given path."""

"""Planners that improve an initial guess."""

"""Fronts of motion against impact, and the choice of w."""

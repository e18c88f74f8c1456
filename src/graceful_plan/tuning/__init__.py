"""Pareto fronts of motion against impact, and the choice of the safety weight w."""

"""Costs to compose: each runs in the core, has a gradient, and adds up with others and with the impact of failures."""

"""Interaction models, one folder each: the probability that each entity is hit, given a failure at a state."""

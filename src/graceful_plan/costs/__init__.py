"""Costs: the contract, motion, impact, and the objective that puts them together."""

"""Bases that drive: how they do it, and goals for them."""

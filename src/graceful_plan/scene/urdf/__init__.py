"""Robots from URDF, with what SRDF says of them."""

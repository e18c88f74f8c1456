"""Robots from URDF and SRDF."""

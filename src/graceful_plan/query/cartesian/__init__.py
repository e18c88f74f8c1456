"""Motions that are asked for in the tool's space."""

"""Motions that are specified in the tool's space."""

"""Stages of a call of plan(): checked arguments, endpoints, candidate motions, verification, result."""

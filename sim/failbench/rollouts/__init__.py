"""Rollouts: executions in which something breaks."""

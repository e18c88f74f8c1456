"""Rollouts: executions during which a fault begins."""

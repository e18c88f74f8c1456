"""Rollouts to look at."""

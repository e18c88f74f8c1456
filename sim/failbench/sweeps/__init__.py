"""Sweeps: datasets of many rollouts, robust against interruptions."""

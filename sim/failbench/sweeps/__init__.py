"""Datasets of many rollouts, made so that nothing is lost."""

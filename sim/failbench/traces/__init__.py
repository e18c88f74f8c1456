"""Rollouts step by step, as tables for those who learn from them."""

"""Simulate wheeled robots with rotating wheels: their behaviour after failures and their tracking of plans."""

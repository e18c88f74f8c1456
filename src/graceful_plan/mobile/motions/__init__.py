"""Motions of bases: rolling curves, their optimisation by descent, and their timing."""

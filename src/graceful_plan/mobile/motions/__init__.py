"""Motions of bases: stages of a path, smooth curves, postures along them, and where to drive slowly."""

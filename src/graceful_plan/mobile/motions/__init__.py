"""Motions of bases: curves that they can roll along, descents of these, and their timing."""

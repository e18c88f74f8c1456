"""Whole tasks of the benchmark `jobs`: scenes, drawn variants, and the ways to plan them that are compared."""

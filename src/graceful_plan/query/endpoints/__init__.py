"""Conversion of the user's start and goal to usable configurations at both ends of a plan."""

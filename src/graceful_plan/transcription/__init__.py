"""Joint optimisation of path and timing."""

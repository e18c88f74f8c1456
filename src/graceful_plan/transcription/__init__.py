"""Path and timing optimised at once."""

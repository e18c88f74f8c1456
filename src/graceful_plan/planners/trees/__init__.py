"""Tree-based planners."""

"""Everything that drives."""

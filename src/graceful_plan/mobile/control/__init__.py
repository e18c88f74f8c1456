"""Controllers of bases that drive: pure functions and frozen settings, without any simulation."""

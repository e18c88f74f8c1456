"""Controllers for mobile bases: pure functions and frozen settings, without simulation."""

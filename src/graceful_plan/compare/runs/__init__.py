"""Running planners on suites of problems."""

"""Runs of planners on suites of problems."""

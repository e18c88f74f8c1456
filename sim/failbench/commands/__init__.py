"""The commands of `failbench`, by topic."""

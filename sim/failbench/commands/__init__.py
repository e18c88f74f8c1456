"""The commands of `failbench`, by what they are about."""

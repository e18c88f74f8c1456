"""The method's own model: Algorithm 1."""

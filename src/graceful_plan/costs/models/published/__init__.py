"""The model of the paper: Algorithm 1."""

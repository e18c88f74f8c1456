"""Records of rollouts, and their scores."""

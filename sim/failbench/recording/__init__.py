"""What is recorded of a rollout, and its score."""

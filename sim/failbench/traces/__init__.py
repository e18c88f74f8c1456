"""Step-by-step traces of rollouts, as tables for machine learning."""

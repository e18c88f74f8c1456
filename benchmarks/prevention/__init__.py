"""What `prevention` is made of: costs of common sense, runs, figures and tables."""

"""Floor maps on the command line."""

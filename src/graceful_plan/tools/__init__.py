"""Programs: the command line and what only it needs."""

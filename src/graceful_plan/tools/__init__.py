"""The command line and its helpers."""

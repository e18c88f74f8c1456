"""Scenes from files, and the bundled ones."""

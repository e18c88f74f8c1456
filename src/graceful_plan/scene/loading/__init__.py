"""Scenes from files, and the bundled scenes."""

"""Readers and writers of floor map files."""

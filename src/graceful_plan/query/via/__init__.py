"""Motions through intermediate poses and configurations."""

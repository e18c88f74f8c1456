"""Planners for a base that rolls along its heading and turns in place."""

"""Interaction models, a folder each: who is hit if the robot fails here."""

"""Constraints on a motion other than collisions: contents stay in, trays stay level, distances are kept."""

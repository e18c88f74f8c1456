"""Hits of dropped objects and failing arms on moving entities."""

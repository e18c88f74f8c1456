"""The judge, an independent checker of motions: exact geometry, no code shared with the planners."""

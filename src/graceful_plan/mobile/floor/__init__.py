"""Maps of floors and what is planned on them: curves of bases that steer, and lattices over (x, y, heading)."""

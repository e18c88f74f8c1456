"""Floor maps and planning on them: curves of steered bases, grids, and lattices over (x, y, heading)."""

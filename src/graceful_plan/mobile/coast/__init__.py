"""Models of a base after a failure: its coasting distance and the entities it hits."""

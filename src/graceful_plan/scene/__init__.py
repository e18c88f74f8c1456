"""Scene descriptions: robot, surroundings, carried object, and the entities that can be harmed."""

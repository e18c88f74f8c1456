"""What is described: robot, surroundings, what is carried, who may be harmed."""

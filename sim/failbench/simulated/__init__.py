"""The simulated robot and world, and the gripper, base and moving entities in it."""

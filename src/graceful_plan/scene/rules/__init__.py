"""Rules: constraints of motions as plain data about the frames of a scene, for planners and judge alike."""

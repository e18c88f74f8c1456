"""What a dropped object does to entities that move."""

"""What has to hold along a motion besides not to collide: contents stay in, trays stay level, distances are kept."""

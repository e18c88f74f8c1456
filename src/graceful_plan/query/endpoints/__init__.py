"""From start and goal as users give them to both ends of a plan."""

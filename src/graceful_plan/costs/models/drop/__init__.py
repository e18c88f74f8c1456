"""Where a dropped object comes down."""

"""Where what is inside of the carried object gets to."""

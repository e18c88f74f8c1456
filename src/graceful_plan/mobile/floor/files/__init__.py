"""Files that maps of floors come in."""

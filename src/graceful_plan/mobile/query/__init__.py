"""From the ends of a drive to a verified motion, and where to stand for a pose."""

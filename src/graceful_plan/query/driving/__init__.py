"""From paths of a base to smooth, timed drives."""

"""Verified motions between the ends of a drive, and base placement for tool poses."""

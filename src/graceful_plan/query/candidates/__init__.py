"""Candidate motions of increasing quality: searches, descents and timing."""

"""What a failing arm strikes."""

"""What plan() does, in order."""

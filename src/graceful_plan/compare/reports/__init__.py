"""What a comparison says, in numbers, tables and pictures."""

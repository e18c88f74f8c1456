"""What a base does after it failed: how far it goes on, and whom it meets."""

"""What every room of the harness uses."""

"""The body model: contacts of a failing arm."""

"""Single configurations that a motion begins or ends with: which may be used, and the ways out of tight places."""

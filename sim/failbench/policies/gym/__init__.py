"""Gymnasium environments; they need the extra `policies` and are imported on demand."""

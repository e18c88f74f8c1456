"""Environments of Gymnasium, which comes with the extra `policies`; imported on demand."""

"""Scene tables as arrays, and the native kernels that read them."""

"""What is computed fast: arrays, and the native kernels on them."""

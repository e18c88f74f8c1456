"""Benchmarks: one runner, one module per subject, one file per subject in results/. The library never imports this."""

"""Benchmarks: one runner, one module a subject, results in RESULTS.md. The library never imports this."""

"""Reports of a comparison: numbers, tables and figures."""

"""Parts of the benchmark `prevention`: simple costs to compare with, runs, figures and tables."""

"""Parts of the benchmark `libero`: drawn tasks, their export, scenes, motions and figures."""

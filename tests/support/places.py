"""Paths of the repository."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
LIBRARY = ROOT / "src" / "graceful_plan"
SUPPORT = Path(__file__).parent

"""Comparing planners on suites of problems: `graceful-plan bench`. Imported only on demand."""

from graceful_plan.bench.comparison import Comparison, Settings, compare, load_comparison
from graceful_plan.bench.records import Run
from graceful_plan.bench.suite import Suite, load_suite, suites

__all__ = ["Comparison", "Run", "Settings", "Suite", "compare", "load_comparison", "load_suite", "suites"]

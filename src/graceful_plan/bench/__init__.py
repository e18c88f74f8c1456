"""Comparing planners on suites of problems: `graceful-plan bench`. Imported only on demand."""

from graceful_plan.bench.comparison import Comparison, Settings, compare, load_comparison
from graceful_plan.bench.known import read_known
from graceful_plan.bench.output import check_exports, text, write
from graceful_plan.bench.records import Run
from graceful_plan.bench.suite import Suite, load_suite, suites
from graceful_plan.bench.summary import PlannerSummary, Summary, summarise

__all__ = [
    "Comparison",
    "PlannerSummary",
    "Run",
    "Settings",
    "Suite",
    "Summary",
    "check_exports",
    "compare",
    "load_comparison",
    "load_suite",
    "read_known",
    "suites",
    "summarise",
    "text",
    "write",
]

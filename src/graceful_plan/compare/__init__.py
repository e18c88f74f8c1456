"""Comparison of planners on suites of problems (`graceful-plan bench`). Imported only on demand."""

from graceful_plan.compare.problems.suite import Suite, load_suite, suites
from graceful_plan.compare.reports.in_space import in_space
from graceful_plan.compare.reports.output import check_exports, text, write
from graceful_plan.compare.reports.summary import PlannerSummary, Summary, summarise
from graceful_plan.compare.runs.best_motions import BestMotion, BestMotions
from graceful_plan.compare.runs.comparison import Comparison, Settings, compare, load_comparison
from graceful_plan.compare.runs.known import read_known
from graceful_plan.compare.runs.planner_specs import REFINED
from graceful_plan.compare.runs.records import Run

__all__ = [
    "REFINED",
    "BestMotion",
    "BestMotions",
    "Comparison",
    "PlannerSummary",
    "Run",
    "Settings",
    "Suite",
    "Summary",
    "check_exports",
    "compare",
    "in_space",
    "load_comparison",
    "load_suite",
    "read_known",
    "suites",
    "summarise",
    "text",
    "write",
]

"""Output files of a comparison other than the journal, and the table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from graceful_plan import documents
from graceful_plan.compare.reports.arena import write_arena
from graceful_plan.compare.reports.calls import CallSummary
from graceful_plan.compare.reports.report import write_report
from graceful_plan.compare.reports.summary import Summary
from graceful_plan.compare.reports.tables import write_csv, write_parquet
from graceful_plan.compare.runs.known import write_known
from graceful_plan.compare.runs.records import EARLY
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.formats.parquet_file import check_arrow
from graceful_plan.viz.html_page import number, p_value, percent

EXPORTS: Mapping[str, Callable[[Summary, Path], tuple[Path, ...]]] = {
    "csv": lambda summary, folder: write_csv(summary.comparison, folder),
    "parquet": lambda summary, folder: write_parquet(summary.comparison, folder),
    "arena": lambda summary, folder: (write_arena(summary.comparison, folder),),
}


def check_exports(names: Sequence[str]) -> None:
    """Check before long runs that the requested exports are possible.

    Raises:
        UnknownNameError: If an export does not exist.
        MissingArrow: If Parquet is requested without pyarrow.
    """
    for name in names:
        if name not in EXPORTS:
            raise UnknownNameError("export", name, EXPORTS)
    if "parquet" in names:
        check_arrow()


def write(
    summary: Summary, folder: str | Path, exports: Sequence[str] = (), *, space: Mapping[str, str] | None = None
) -> tuple[Path, ...]:
    """Write the report, best-known costs and exports; return the files.

    Args:
        summary: Summary of the comparison.
        folder: Output folder.
        exports: Any of "csv", "parquet" and "arena" (see `tables` and `arena`).
        space: 3-D view of the page, from `in_space`; none by default.

    Raises:
        GracefulPlanError: As in `check_exports`.
    """
    check_exports(exports)
    folder = Path(folder)
    files = [write_report(summary, folder, space), write_known(summary.best, summary.comparison.w, folder)]
    for name in exports:
        files += EXPORTS[name](summary, folder)
    return tuple(files)


def text(summary: Summary) -> str:
    """Return a table of planners for the terminal."""
    against = {pair.second: pair for pair in summary.pairs if pair.first == summary.comparison.planners[0]}
    at = list(summary.planners[0].gap_at)[-4:]
    rows = []
    for planner in summary.planners:
        pair = against.get(planner.planner)
        rows.append(
            [
                planner.planner,
                f"{planner.solved}/{planner.runs}",
                number(1e3 * planner.first),
                *(percent(planner.gap_at[time]) for time in at),
                percent(planner.gap),
                "reference" if pair is None else f"{pair.wins}/{pair.ties}/{pair.losses}",
                "" if pair is None else number(pair.ratio, 4),
                "" if pair is None else p_value(pair.p_holm),
            ]
        )
    header = ["planner", "solved", "first [ms]", *(f"gap {time} s" for time in at), "gap", "win/tie/loss", "ratio", "p"]
    calls = ["", _calls(summary.calls)] if summary.calls else []
    return "\n".join([documents.table(header, rows), *calls])


def _calls(calls: Sequence[CallSummary]) -> str:
    header = ["kind", "planner", "solved", "refused", "first [ms]", "motion [ms]", "CPU [ms]", "over p99 [ms]"]
    early = EARLY if any(row.early for row in calls) else ()  # empty for a planner without solutions
    rows = [
        [row.group, row.planner, f"{row.solved}/{row.runs}", str(row.refused)]
        + [number(1e3 * t) for t in (row.search, row.motion_wall, row.motion_cpu, max(row.over, 0.0))]
        + [number(value) for value in row.early or (math.nan,) * len(early)]
        for row in calls
    ]
    return documents.table([*header, *(f"path {1e3 * at:g} ms" for at in early)], rows)

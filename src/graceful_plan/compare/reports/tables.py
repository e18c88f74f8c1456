"""Runs as tables for other programs: CSV and Parquet."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from graceful_plan.compare.reports.summary import best_known, gap
from graceful_plan.compare.runs.comparison import Comparison
from graceful_plan.compare.runs.records import Run
from graceful_plan.formats.parquet_file import check_arrow

UNITS: Mapping[str, str] = {
    "seconds": "s",
    "first": "s",
    "motion_wall": "s",
    "motion_cpu": "s",
    "time": "s",
    "jerk_peak": "rad/s^3",
    "jerk_rms": "rad/s^3",
    "duration": "s",
    "length": "rad",
    "clearance": "m",
    "self_clearance": "m",
    "certified": "m",
}
_LONG = ("early", "trace", "path", "times", "velocities")
RUN_COLUMNS = (*(item.name for item in fields(Run) if item.name not in _LONG), "best_known", "gap")
TRACE_COLUMNS = ("problem", "planner", "seed", "time", "total", "motion", "impact", "gap")
_INTEGERS, _TEXTS = ("seed",), ("problem", "planner", "status", "detail")


def run_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Return a row for every run; non-finite values are None."""
    best = best_known(comparison)
    return [
        {
            name: _plain(value)
            for name, value in {
                **{name: getattr(run, name) for name in RUN_COLUMNS[:-2]},
                "best_known": best[run.problem],
                "gap": gap(run.total, best[run.problem]),
            }.items()
        }
        for run in comparison.runs
    ]


def trace_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Return a row for every improvement of every run."""
    best = best_known(comparison)
    return [
        {
            "problem": run.problem,
            "planner": run.planner,
            "seed": run.seed,
            "time": point.time,
            "total": point.total,
            "motion": point.motion,
            "impact": point.impact,
            "gap": _plain(gap(point.total, best[run.problem])),
        }
        for run in comparison.runs
        for point in run.trace
    ]


def write_csv(comparison: Comparison, folder: Path) -> tuple[Path, ...]:
    """Write runs.csv and trace.csv; cells of non-finite values are empty."""
    return _write(comparison, folder, "csv", _to_csv)


def write_parquet(comparison: Comparison, folder: Path) -> tuple[Path, ...]:
    """Write runs.parquet and trace.parquet, with the unit of each column in its metadata.

    Raises:
        MissingArrow: If pyarrow is not installed.
    """
    check_arrow()
    return _write(comparison, folder, "parquet", _to_parquet)


def _write(
    comparison: Comparison, folder: Path, ending: str, write: Callable[[Path, tuple[str, ...], Any], None]
) -> tuple[Path, ...]:
    tables = {"runs": (RUN_COLUMNS, run_rows(comparison)), "trace": (TRACE_COLUMNS, trace_rows(comparison))}
    files = []
    for name, (columns, rows) in tables.items():
        file = folder / f"{name}.{ending}"
        partial = file.with_suffix(".partial")
        write(partial, columns, rows)
        partial.replace(file)
        files.append(file)
    return tuple(files)


def _to_csv(file: Path, columns: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _to_parquet(file: Path, columns: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    def kind(name: str) -> pa.DataType:
        return pa.int64() if name in _INTEGERS else pa.string() if name in _TEXTS else pa.float64()

    schema = pa.schema([pa.field(name, kind(name), metadata={"unit": UNITS.get(name, "")}) for name in columns])
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), file, compression="zstd")


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value

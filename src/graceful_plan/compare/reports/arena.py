"""Export to the database of OMPL's Planner Arena, an SQLite file for plannerarena.org.

Tables: `experiments` (here one per problem), `plannerConfigs`, `enums` (names of the values of ENUM columns), `runs`
and `progress`. Planner Arena requires the first twelve columns of `experiments`, the first three of `runs`, and
`best_cost` in `progress`. It shows all other columns of `runs` by their declared type. It joins these tables, so no
other column of `progress` may have the name of one of `runs`. It fits curves to the rows of `progress`, which therefore
contain the best path at regular times, as written by OMPL.

References:
    Moll, Sucan and Kavraki, "Benchmarking motion planning algorithms: an extensible infrastructure for analysis and
    visualization", IEEE Robotics & Automation Magazine, 2015. The layout is that of ompl_benchmark_statistics.py.
"""

from __future__ import annotations

import json
import math
import sqlite3
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from graceful_plan.compare.reports.summary import best_known, gap
from graceful_plan.compare.runs.comparison import Comparison
from graceful_plan.compare.runs.records import CRASHED, HUNG, RAISED, Run
from graceful_plan.result import PlanStatus

NAME = "planner_arena.db"
STATUSES = (*(status.name for status in PlanStatus), RAISED, CRASHED, HUNG)

_RUN_COLUMNS: Mapping[str, tuple[str, Callable[[Run, float], Any]]] = {
    "time": ("REAL", lambda run, _: run.seconds),
    "status": ("ENUM", lambda run, _: STATUSES.index(run.status)),
    "solved": ("BOOLEAN", lambda run, _: int(run.solved)),
    "time_to_first_path": ("REAL", lambda run, _: run.first),
    "best_cost": ("REAL", lambda run, _: run.total),
    "gap_to_best_known": ("REAL", lambda run, best: gap(run.total, best)),
    "motion_cost": ("REAL", lambda run, _: run.motion),
    "impact": ("REAL", lambda run, _: run.impact),
    "solution_length": ("REAL", lambda run, _: run.length),
    "solution_clearance": ("REAL", lambda run, _: run.clearance),
    "self_clearance": ("REAL", lambda run, _: run.self_clearance),
    "certified_clearance": ("REAL", lambda run, _: run.certified),
    "solution_duration": ("REAL", lambda run, _: run.duration),
    "waypoint_jerk_peak": ("REAL", lambda run, _: run.jerk_peak),
    "waypoint_jerk_rms": ("REAL", lambda run, _: run.jerk_rms),
    "iterations": ("INTEGER", lambda run, _: run.iterations),
    "random_seed": ("INTEGER", lambda run, _: run.seed),
}
_PROGRESS_COLUMNS = ("best_cost", "best_motion_cost", "best_impact")
_UPDATES = 100
"""Number of progress rows of a run that has a path from the start."""

_TABLES = (
    "CREATE TABLE experiments (id INTEGER PRIMARY KEY AUTOINCREMENT, name VARCHAR(512), totaltime REAL, timelimit REAL,"
    " memorylimit REAL, runcount INTEGER, version VARCHAR(128), hostname VARCHAR(1024), cpuinfo TEXT, date DATETIME,"
    " seed INTEGER, setup TEXT)",
    "CREATE TABLE plannerConfigs (id INTEGER PRIMARY KEY AUTOINCREMENT, name VARCHAR(512) NOT NULL, settings TEXT)",
    "CREATE TABLE enums (name VARCHAR(512), value INTEGER, description TEXT, PRIMARY KEY (name, value))",
    "CREATE TABLE runs (id INTEGER PRIMARY KEY AUTOINCREMENT, experimentid INTEGER, plannerid INTEGER, "
    + ", ".join(f"{name} {kind}" for name, (kind, _) in _RUN_COLUMNS.items())
    + ", FOREIGN KEY (experimentid) REFERENCES experiments(id) ON DELETE CASCADE"
    ", FOREIGN KEY (plannerid) REFERENCES plannerConfigs(id) ON DELETE CASCADE)",
    "CREATE TABLE progress (runid INTEGER, time REAL, "
    + ", ".join(f"{name} REAL" for name in _PROGRESS_COLUMNS)
    + ", PRIMARY KEY (runid, time), FOREIGN KEY (runid) REFERENCES runs(id) ON DELETE CASCADE)",
)


def write_arena(comparison: Comparison, folder: Path) -> Path:
    """Write the database; an existing file is replaced once the new one is complete."""
    file = folder / NAME
    partial = file.with_suffix(".partial")
    partial.unlink(missing_ok=True)
    with closing(sqlite3.connect(partial)) as database:
        with database:
            _fill(database, comparison)
    partial.replace(file)
    return file


def _fill(database: sqlite3.Connection, comparison: Comparison) -> None:
    for table in _TABLES:
        database.execute(table)
    database.executemany(
        "INSERT INTO enums VALUES ('status', ?, ?)",
        [(i, name.replace("_", " ").capitalize()) for i, name in enumerate(STATUSES)],
    )
    planners = {document["label"]: document for document in comparison.settings["planners"]}
    planner_ids = {
        label: database.execute(
            "INSERT INTO plannerConfigs (name, settings) VALUES (?, ?)",
            (label, json.dumps(planners[label]["settings"])),
        ).lastrowid
        for label in comparison.planners
    }
    best = best_known(comparison)
    for problem in comparison.problems:
        experiment = _add_experiment(database, comparison, problem)
        for run in comparison.of(problem=problem):
            added = _add_run(database, experiment, planner_ids[run.planner], run, best[problem])
            rows = ((added, *row) for row in _progress(run, comparison.seconds))
            database.executemany("INSERT INTO progress VALUES (?, ?, ?, ?, ?)", rows)


def _add_experiment(database: sqlite3.Connection, comparison: Comparison, problem: str) -> int | None:
    runs = comparison.of(problem=problem)
    machine = comparison.machine
    row = {
        "name": problem,
        "totaltime": sum(run.seconds for run in runs if math.isfinite(run.seconds)),
        "timelimit": comparison.seconds,
        "memorylimit": 0.0,
        "runcount": len(comparison.seeds),
        "version": machine["versions"].split(",")[0],
        "hostname": "",
        "cpuinfo": f"{machine['processor']}, {machine['cores']} cores, {machine['memory']}",
        "date": comparison.begun,
        "seed": comparison.seeds[0],
        "setup": json.dumps({"suite": comparison.suite, "w": comparison.w, "machine": dict(machine)}),
    }
    names = ", ".join(row)
    places = ", ".join("?" * len(row))
    return database.execute(f"INSERT INTO experiments ({names}) VALUES ({places})", tuple(row.values())).lastrowid


def _add_run(
    database: sqlite3.Connection, experiment: int | None, planner: int | None, run: Run, best: float
) -> int | None:
    values = [_plain(value(run, best)) for _, value in _RUN_COLUMNS.values()]
    places = ", ".join("?" * (len(values) + 2))
    names = ", ".join(["experimentid", "plannerid", *_RUN_COLUMNS])
    return database.execute(f"INSERT INTO runs ({names}) VALUES ({places})", (experiment, planner, *values)).lastrowid


def _progress(run: Run, seconds: float) -> Iterator[tuple[float, float, float, float]]:
    """Yield time and costs of the best path at regular times, from the first path on."""
    times = [point.time for point in run.trace]
    for i in range(1, _UPDATES + 1):
        time = seconds * i / _UPDATES
        reached = bisect_right(times, time)
        if reached:
            point = run.trace[reached - 1]
            yield time, point.total, point.motion, point.impact


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value

import builtins
import csv
import importlib.util
import math
import sqlite3
from contextlib import closing

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_cases import PROBLEMS, all_failed, comparison, rich

from graceful_plan import compare as bench
from graceful_plan.compare.reports.arena import NAME, STATUSES, write_arena
from graceful_plan.compare.reports.tables import RUN_COLUMNS, TRACE_COLUMNS, write_csv, write_parquet
from graceful_plan.compare.runs.known import known_costs, read_known, write_known
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError
from graceful_plan.formats.parquet_file import MissingArrow


def test_csv_has_a_row_for_every_run(tmp_path):
    compared = rich()
    runs, trace = write_csv(compared, tmp_path)
    with runs.open() as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == RUN_COLUMNS
    assert len(rows) == len(compared.runs)
    assert [row["planner"] for row in rows] == [run.planner for run in compared.runs]
    for row, run in zip(rows, compared.runs, strict=True):
        assert (float(row["total"]) if row["total"] else math.inf) == run.total
        assert row["gap"] == "" if not run.solved else float(row["gap"]) >= 0.0
    with trace.open() as stream:
        points = list(csv.DictReader(stream))
    assert tuple(points[0]) == TRACE_COLUMNS
    assert len(points) == sum(len(run.trace) for run in compared.runs)


def test_parquet_has_the_same_rows(tmp_path):
    compared = rich()
    runs, trace = (pq.read_table(file) for file in write_parquet(compared, tmp_path))
    assert tuple(runs.column_names) == RUN_COLUMNS
    assert runs["seed"].to_pylist() == [run.seed for run in compared.runs]
    assert runs["total"].to_pylist() == [run.total if run.solved else None for run in compared.runs]
    assert runs.schema.field("jerk_peak").metadata == {b"unit": b"rad/s^3"}
    assert trace.num_rows == sum(len(run.trace) for run in compared.runs)
    assert {str(runs.schema.field(name).type) for name in ("total", "seed", "status")} == {"double", "int64", "string"}


@pytest.mark.parametrize("compared", [all_failed(), comparison([], ("a",), ("p",))], ids=["all failed", "no runs"])
def test_an_empty_comparison_can_be_written(tmp_path, compared):
    for file in (*write_csv(compared, tmp_path), *write_parquet(compared, tmp_path), write_arena(compared, tmp_path)):
        assert file.exists()
    assert pq.read_table(tmp_path / "trace.parquet").num_rows == 0
    assert (tmp_path / "trace.csv").read_text() == ",".join(TRACE_COLUMNS) + "\n"


def test_without_pyarrow_the_message_helps(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "pyarrow" else find(name, *a))
    imported = builtins.__import__
    monkeypatch.setattr(
        builtins,
        "__import__",
        lambda name, *a, **k: pytest.fail(name) if "pyarrow" in name else imported(name, *a, **k),
    )
    with pytest.raises(MissingArrow, match=r"pip install '\.\[data\]'"):
        write_parquet(rich(), tmp_path)
    with pytest.raises(MissingArrow):
        bench.check_exports(["csv", "parquet"])


def test_exports_have_names():
    with pytest.raises(UnknownNameError, match=r"'excel'.*arena, csv, parquet"):
        bench.check_exports(["excel"])


# --- Planner Arena ---------------------------------------------------------------------------------------------------


@pytest.fixture
def arena(tmp_path):
    with closing(sqlite3.connect(write_arena(rich(), tmp_path))) as database:
        yield database


def columns(database, table):
    return [row[1] for row in database.execute(f"PRAGMA table_info({table})")]


def test_arena_has_the_tables_of_ompl(arena):
    tables = {name for (name,) in arena.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    assert tables - {"sqlite_sequence"} == {"experiments", "plannerConfigs", "enums", "runs", "progress"}
    # Planner Arena expects the columns in this order.
    assert columns(arena, "experiments") == (
        "id name totaltime timelimit memorylimit runcount version hostname cpuinfo date seed setup".split()
    )
    assert columns(arena, "plannerConfigs") == ["id", "name", "settings"]
    assert columns(arena, "enums") == ["name", "value", "description"]
    assert columns(arena, "runs")[:6] == ["id", "experimentid", "plannerid", "time", "status", "solved"]
    assert columns(arena, "progress")[:3] == ["runid", "time", "best_cost"]
    assert arena.execute("PRAGMA foreign_key_check").fetchall() == []
    assert arena.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


def test_arena_has_every_run(arena):
    compared = rich()

    def count(table):
        return arena.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0]

    assert (count("experiments"), count("plannerConfigs"), count("runs")) == (7, 3, 42)
    solved = [run for run in compared.runs if run.solved]
    # A row per 5 ms of half a second; every planner has a path by then.
    assert count("progress") == 100 * len(solved)
    assert count("enums") == len(STATUSES)
    joined = arena.execute(
        "SELECT experiments.name, plannerConfigs.name, random_seed, enums.description, solved, runs.best_cost "
        "FROM runs JOIN experiments ON experiments.id = experimentid "
        "JOIN plannerConfigs ON plannerConfigs.id = plannerid "
        "JOIN enums ON enums.name = 'status' AND enums.value = status ORDER BY runs.id"
    ).fetchall()
    expected = [
        (run.problem, run.planner, run.seed, run.status.capitalize(), run.solved, run.total if run.solved else None)
        for run in compared.runs
    ]
    assert joined == expected


def test_progress_and_runs_share_only_two_columns(arena):
    # Planner Arena joins both tables, and renames these two columns itself.
    assert set(columns(arena, "runs")) & set(columns(arena, "progress")) == {"time", "best_cost"}


def test_progress_is_the_best_so_far(arena):
    (run,) = [run for run in rich().runs if run.key == (PROBLEMS[0], "first", 1)]
    found = arena.execute(
        "SELECT progress.time, progress.best_cost FROM progress JOIN runs ON runs.id = runid JOIN experiments ON "
        "experiments.id = experimentid JOIN plannerConfigs ON plannerConfigs.id = plannerid WHERE random_seed = 1 AND "
        "plannerConfigs.name = 'first' AND experiments.name = ? ORDER BY progress.time",
        (PROBLEMS[0],),
    ).fetchall()
    times, costs = zip(*found, strict=True)
    np.testing.assert_allclose(np.diff([0.0, *times]), 0.005)
    np.testing.assert_allclose(costs, run.totals_at(np.array(times)))


def test_progress_ends_with_the_cost_of_the_run(arena):
    worse = arena.execute(
        "SELECT COUNT(*) FROM runs WHERE solved AND best_cost != "
        "(SELECT MIN(best_cost) FROM progress WHERE runid = runs.id)"
    ).fetchone()
    assert worse == (0,)


def test_an_older_database_is_replaced(tmp_path):
    (tmp_path / NAME).write_text("old")
    (tmp_path / NAME).with_suffix(".partial").write_text("older")
    for _ in range(2):
        write_arena(rich(), tmp_path)
    with closing(sqlite3.connect(tmp_path / NAME)) as database:
        assert database.execute("SELECT COUNT(*) FROM runs").fetchone() == (42,)


# --- best known ------------------------------------------------------------------------------------------------------


def test_best_known_costs_survive_writing_and_reading(tmp_path):
    names = {'room "a": #1': 1.25, "b/c": 0.0, "never": math.inf}
    file = write_known(names, 0.5, tmp_path)
    assert read_known(file) == read_known(file, 0.5) == {'room "a": #1': 1.25, "b/c": 0.0}
    assert read_known(write_known({}, 1.0, tmp_path)) == {}
    with pytest.raises(SettingError, match=r"w = 2\.0.*best_known\.yaml"):
        read_known(file, 2.0)


def test_other_files_are_not_best_known(tmp_path):
    file = tmp_path / "x.yaml"
    file.write_text("version: 1\nw: 1\ncosts: {}\n")
    with pytest.raises(SceneError, match="unknown key 'costs'"):
        read_known(file)
    file.write_text("version: 3\nw: 1\nbest_known: {}\n")
    with pytest.raises(SceneError, match=r"version 3.*1"):
        read_known(file)


def test_the_least_counts():
    assert known_costs({"a": 1.0, "b": 2.0}, {"b": 1.5, "c": 3.0}) == {"a": 1.0, "b": 1.5, "c": 3.0}

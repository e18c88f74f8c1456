"""The best paths known: kept, judged again, and replaced by better ones alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.compare import BestPath, BestPaths, Run, read_known
from graceful_plan.compare.problems.suite import ProblemNote
from graceful_plan.compare.runs.best_paths import Attempt, StaleBestPath
from graceful_plan.compare.runs.planner_notes import PlannerNote
from graceful_plan.compare.runs.runner import PlannerJob, run

SCENE, NAME = "tabletop_l1", "green_to_blue"
TASK = f"{SCENE}/{NAME}"


def task(name: str = NAME) -> gp.Task:
    return gp.load_scene(SCENE).tasks[name]


@pytest.fixture(scope="module")
def found() -> Run:
    note = ProblemNote(name=TASK, kind="task", source=SCENE, item=NAME)
    planner = PlannerNote(label="rrt_connect", name="rrt_connect")
    return run(PlannerJob(problem=note, planner=planner, seed=0, seconds=5.0, w=1.0, measured=False))


@pytest.fixture
def paths(tmp_path) -> BestPaths:
    return BestPaths(tmp_path / "best_known")


@pytest.fixture
def stored(found, paths) -> BestPath:
    best = paths.offer(task(), None, found, 5.0)
    assert best is not None, found
    attempt = Attempt(planner="rrt_connect", seed=0, seconds=5.0, total=best.total)
    return dataclasses.replace(best, runs=(attempt, dataclasses.replace(attempt, seed=1, total=None)))


def test_a_run_can_do_without_what_takes_long_to_measure(found):
    assert found.solved and found.first == found.trace[0].time < found.seconds
    assert np.isnan([found.jerk_peak, found.jerk_rms, found.clearance, found.self_clearance, found.certified]).all()
    assert found.total_at(found.seconds) == pytest.approx(found.total)


def test_a_stored_path_comes_back(stored, paths):
    paths.write(stored)
    assert paths.load(TASK, task()) == stored
    assert paths.renewed(TASK, task()) == stored
    assert [file.name for file in paths.folder.iterdir()] == ["tabletop_l1.green_to_blue.json"]
    assert paths.totals() == read_known(paths.folder) == read_known(paths.folder, 1.0) == {TASK: stored.total}


def test_a_task_without_a_file_has_no_best_path(paths):
    assert paths.load(TASK, task()) is None
    assert paths.renewed(TASK, task()) is None
    assert paths.totals() == {}


def test_a_total_that_does_not_match_its_path_is_refused_and_renewed(stored, paths):
    paths.write(dataclasses.replace(stored, total=0.9 * stored.total))
    for read in (lambda: paths.load(TASK, task()), paths.totals):
        with pytest.raises(StaleBestPath, match="stored total"):
            read()
    renewed = paths.renewed(TASK, task())
    assert renewed is not None and renewed.total == pytest.approx(stored.total)
    assert renewed.runs == ()


def test_a_path_of_another_task_is_refused(stored, paths):
    paths.write(stored)
    other = task("far_to_near")
    with pytest.raises(StaleBestPath, match="does not begin at the start"):
        paths.load(TASK, other)
    assert paths.renewed(TASK, other) is None


def test_a_path_for_another_weight_is_refused(stored, paths):
    paths.write(stored)
    with pytest.raises(StaleBestPath, match="another schema or weight"):
        read_known(paths.folder, 2.0)


def test_a_colliding_path_is_refused(stored, paths):
    inside = task().start.copy()
    inside[1:4] = [1.5, 0.0, -0.5]  # arm stretched out into the table
    paths.write(dataclasses.replace(stored, path=(stored.path[0], tuple(inside), stored.path[-1])))
    with pytest.raises(StaleBestPath, match="collision"):
        paths.load(TASK, task())
    assert paths.renewed(TASK, task()) is None


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "{}",
        '{"schema": 2, "w": 1.0}',
        '{"schema": 1, "w": 0.5}',
        '{"schema": 1, "w": 1.0, "runs": [], "path": [], "x": 1}',
    ],
)
def test_files_of_another_format_are_refused(paths, text):
    file = paths.file_of(TASK)
    file.parent.mkdir()
    file.write_text(text)
    with pytest.raises(StaleBestPath, match=file.name):
        paths.load(TASK, task())
    assert paths.renewed(TASK, task()) is None


def test_only_a_better_path_replaces_the_best(stored, found, paths):
    q = np.array(found.path)
    detour = np.concatenate([q[:1], q[:2], q])  # to the second vertex, back and again
    worse = dataclasses.replace(found, path=tuple(map(tuple, detour.tolist())))
    assert paths.offer(task(), stored, worse, 1.0) is stored
    assert paths.offer(task(), stored, found, 1.0) is stored
    better = paths.offer(
        task(), dataclasses.replace(stored, total=stored.total + 1.0), dataclasses.replace(found, seed=7), 1.0
    )
    assert better is not None and (better.total, better.seed, better.seconds) == (stored.total, 7, 1.0)
    assert better.runs == stored.runs


def test_what_is_no_solution_is_not_taken(found, paths):
    assert paths.offer(task(), None, dataclasses.replace(found, path=found.path[:-1]), 1.0) is None
    assert paths.offer(task(), None, dataclasses.replace(found, status="TIMEOUT"), 1.0) is None

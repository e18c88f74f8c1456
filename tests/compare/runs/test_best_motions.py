"""The best motions known: stored, verified again, and replaced only by better ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.compare import BestMotion, BestMotions, Run, read_known
from graceful_plan.compare.problems.suite import ProblemSpec
from graceful_plan.compare.runs.best_motions import Attempt, StaleBestMotion
from graceful_plan.compare.runs.planner_specs import PlannerSpec
from graceful_plan.compare.runs.records import cubics
from graceful_plan.compare.runs.runner import PlannerJob, run

SCENE, NAME = "tabletop_l1", "green_to_blue"
TASK = f"{SCENE}/{NAME}"


def task(name: str = NAME) -> gp.Task:
    return gp.load_scene(SCENE).tasks[name]


@pytest.fixture(scope="module")
def found() -> Run:
    note = ProblemSpec(name=TASK, kind="task", source=SCENE, item=NAME)
    planner = PlannerSpec(label="rrt_connect", name="rrt_connect")
    return run(PlannerJob(problem=note, planner=planner, seed=0, seconds=2.0, w=1.0, measured=False))


@pytest.fixture
def motions(tmp_path) -> BestMotions:
    return BestMotions(tmp_path / "best_known")


@pytest.fixture
def stored(found, motions) -> BestMotion:
    best = motions.offer(task(), None, found, 5.0)
    assert best is not None, found
    attempt = Attempt(planner="rrt_connect", seed=0, seconds=2.0, total=best.total)
    return dataclasses.replace(best, runs=(attempt, dataclasses.replace(attempt, seed=1, total=None)))


@pytest.mark.long
def test_slow_measurements_can_be_skipped(found):
    assert found.solved and found.first <= found.trace[0].time < found.seconds
    assert np.isnan([found.jerk_peak, found.jerk_rms, found.clearance, found.self_clearance, found.certified]).all()
    assert found.totals_at(found.seconds) == pytest.approx(found.total)


def test_a_stored_motion_comes_back(stored, motions):
    motions.write(stored)
    assert motions.load(TASK, task()) == stored
    assert motions.renewed(TASK, task()) == stored
    assert [file.name for file in motions.folder.iterdir()] == ["tabletop_l1.green_to_blue.json"]
    assert motions.totals() == read_known(motions.folder) == read_known(motions.folder, 1.0) == {TASK: stored.total}


def test_a_task_without_a_file_has_no_best_motion(motions):
    assert motions.load(TASK, task()) is None
    assert motions.renewed(TASK, task()) is None
    assert motions.totals() == {}


def test_a_total_that_does_not_match_its_motion_is_refused_and_renewed(stored, motions):
    motions.write(dataclasses.replace(stored, total=0.9 * stored.total))
    for read in (lambda: motions.load(TASK, task()), motions.totals):
        with pytest.raises(StaleBestMotion, match="stored total"):
            read()
    renewed = motions.renewed(TASK, task())
    assert renewed is not None and renewed.total == pytest.approx(stored.total)
    assert renewed.runs == ()


def test_a_motion_of_another_task_is_refused(stored, motions):
    motions.write(stored)
    other = task("far_to_near")
    with pytest.raises(StaleBestMotion, match="start"):
        motions.load(TASK, other)
    assert motions.renewed(TASK, other) is None


def test_a_motion_for_another_weight_is_refused(stored, motions):
    motions.write(stored)
    with pytest.raises(StaleBestMotion, match="schema or weight"):
        read_known(motions.folder, 2.0)


def test_files_name_their_weight(stored, motions):
    other = BestMotions(motions.folder, 0.5)
    total = stored.motion + 0.5 * stored.impact
    other.write(dataclasses.replace(stored, total=total))
    assert read_known(motions.folder) == read_known(motions.folder, 0.5) == {TASK: pytest.approx(total)}
    motions.write(dataclasses.replace(stored, task=f"{SCENE}/zzz"))
    with pytest.raises(StaleBestMotion, match="schema or weight"):
        read_known(motions.folder)


def test_a_colliding_motion_is_refused(stored, motions):
    inside = task().start.copy()
    inside[1:4] = [1.5, 0.0, -0.5]  # the arm stretched into the table
    scene, ends = task().scene, stored.trajectory(task().scene.joints).q[[0, -1]]
    through = gp.retime(gp.Path(np.insert(ends, 1, inside, axis=0)), scene.limits, scene.joints)
    rows = np.column_stack([through.t, through.q, through.qd])
    motions.write(dataclasses.replace(stored, samples=tuple(map(tuple, rows.tolist()))))
    with pytest.raises(StaleBestMotion, match="collision"):
        motions.load(TASK, task())
    assert motions.renewed(TASK, task()) is None


def test_a_motion_that_is_too_fast_is_refused(stored, motions):
    fast = tuple((0.5 * t, *row[:7], *(2.0 * qd for qd in row[7:])) for t, *row in stored.samples)
    motions.write(dataclasses.replace(stored, samples=fast))
    with pytest.raises(StaleBestMotion, match="velocity_limits"):
        motions.load(TASK, task())
    assert motions.renewed(TASK, task()) is None


def test_a_motion_that_would_lose_the_object_is_refused(stored, motions):
    bottle = gp.load_scene("dining_table").tasks["pass_bottle"]
    scene = bottle.scene
    jerked = gp.retime(gp.Path(np.stack([bottle.start, bottle.goal[0]])), scene.limits, scene.joints)
    rows = np.column_stack([jerked.t, jerked.q, jerked.qd])
    motions.write(dataclasses.replace(stored, samples=tuple(map(tuple, rows.tolist()))))
    with pytest.raises(StaleBestMotion, match="grasp_holds"):
        motions.load(TASK, bottle)


@pytest.mark.parametrize("text", ["{", "{}", "[]", '"text"', '{"schema": 1, "w": 1.0}', '{"schema": 2, "w": 0.5}'])
def test_files_of_another_format_are_refused(motions, text):
    file = motions.file_of(TASK)
    file.parent.mkdir()
    file.write_text(text)
    with pytest.raises(StaleBestMotion, match=file.name):
        motions.load(TASK, task())
    assert motions.renewed(TASK, task()) is None


@pytest.mark.parametrize(
    "samples",
    [(), ((),), ((0.0, 1.0),), ((0.0, *14 * [0.0]), (1.0, *13 * [0.0])), 2 * ((0.0, *14 * [0.0]),)],
    ids=["none", "empty", "short", "ragged", "still"],
)
def test_samples_that_are_no_motion_are_refused(stored, motions, samples):
    motions.write(dataclasses.replace(stored, samples=samples))
    with pytest.raises(StaleBestMotion, match="green_to_blue"):
        motions.load(TASK, task())
    assert motions.renewed(TASK, task()) is None


def test_only_a_better_motion_replaces_the_best(stored, found, motions):
    slower = dataclasses.replace(
        found,
        times=tuple(2.0 * t for t in found.times),
        velocities=tuple(tuple(0.5 * x for x in qd) for qd in found.velocities),
    )
    assert motions.offer(task(), stored, slower, 1.0) is stored
    assert motions.offer(task(), stored, found, 1.0) is stored
    better = motions.offer(
        task(), dataclasses.replace(stored, total=stored.total + 1.0), dataclasses.replace(found, seed=7), 1.0
    )
    assert better is not None and (better.total, better.seed, better.seconds) == (stored.total, 7, 1.0)
    assert better.runs == stored.runs


def test_the_planned_motion_is_stored():
    result = gp.plan(task().start, task().goal, task().scene, w=1.0, iterations=100)
    planned = result.unwrap()
    back = cubics(planned.t.tolist(), planned.q.tolist(), planned.qd.tolist(), task().scene.joints)
    at = np.linspace(0.0, planned.duration, 1000)
    for own, theirs in zip(back.at(at), planned.at(at), strict=True):
        np.testing.assert_array_equal(own, theirs)
    assert gp.verify(back, task().scene, start=task().start, goal=task().goal).passed
    assert gp.evaluate(back, task().scene, gp.Objective(w=1.0)).total == pytest.approx(result.cost.total, rel=1e-12)


def test_unsolved_runs_are_not_stored(found, motions):
    cut = {name: getattr(found, name)[:-1] for name in ("path", "times", "velocities")}
    assert motions.offer(task(), None, dataclasses.replace(found, **cut), 1.0) is None
    assert motions.offer(task(), None, dataclasses.replace(found, status="TIMEOUT"), 1.0) is None
    assert motions.offer(task(), None, dataclasses.replace(found, times=()), 1.0) is None

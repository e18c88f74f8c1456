"""Steps are begun if they fit, what they take is learnt, and what cannot be judged in time is not called solved."""

from __future__ import annotations

import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.planners.planner import Budget
from graceful_plan.query import finish
from graceful_plan.query.answers import searched
from graceful_plan.query.deadline import clock as clock_module
from graceful_plan.query.deadline.clock import Clock, Paces, paces_of
from graceful_plan.query.ends import find_ends
from graceful_plan.result import PlanStatus
from graceful_plan.scene.pose_goal import PoseGoal

LIMIT = 60.0
"""Seconds for plans that take some tenths of one: `iterations` end them, also on a busy machine."""


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stop the time that clocks read, at `still.now`."""
    time_of = SimpleNamespace(now=0.0, perf_counter=lambda: time_of.now)
    monkeypatch.setattr(clock_module, "time", time_of)
    return time_of


@pytest.fixture
def skipped(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Let everybody's time jump ahead by the sum of what the test appends [s]."""
    seconds: list[float] = []
    real = time.perf_counter
    monkeypatch.setattr(time, "perf_counter", lambda: real() + sum(seconds))
    return seconds


def _clock(seconds: float, **steps: list[float]) -> Clock:
    paces = Paces()
    for step, runs in steps.items():
        for run in runs:
            paces.took(step, run)  # type: ignore[arg-type]
    return Clock(clock_module.time.perf_counter() + seconds, paces)


@pytest.mark.usefixtures("still")
def test_there_is_room_for_what_ends_in_time() -> None:
    assert _clock(10.0, judging=[1.0, 2.0, 3.0], timing=[1.0]).has_room("timing", "judging")
    assert not _clock(3.5, judging=[1.0, 2.0, 3.0], timing=[1.0]).has_room("timing", "judging")
    assert not _clock(0.0, judging=[0.1]).has_room("judging")
    assert Clock().has_room("timing", "judging")


@pytest.mark.usefixtures("still")
def test_somebody_has_to_try() -> None:
    """Before there are any runs nothing is known that would be against one, but time is kept for it."""
    assert _clock(-1.0).has_room("judging") and _clock(-1.0, timing=[1.0]).has_room("timing", "judging")
    assert 0.01 < _clock(1.0).reserve(1.0) < 0.2


@pytest.mark.usefixtures("still")
def test_a_single_long_run_is_forgotten_sooner_than_what_runs_mostly_take() -> None:
    def tries(clock: Clock) -> int:
        return next(k for k in range(1000) if clock.has_room("judging"))

    single, always = _clock(1.0, judging=[0.1, 0.1, 5.0]), _clock(1.0, judging=[5.0])
    assert 5 < tries(single) < 100 < tries(always)
    always.paces.took("judging", 5.0)  # it was too late, and is not tried again so soon
    assert tries(always) > 100


def test_predictions_of_those_who_move_keep_what_was_learnt(task) -> None:
    person = gp.MovingEntity("person", "adult", size=[0.2, 0.85], t=[0.0], position=[[9.0, 9.0, 0.85]])
    crossing = task.scene.with_moving(person)
    assert paces_of(crossing) is paces_of(task.scene) is paces_of(crossing.without_moving())


@pytest.mark.usefixtures("still")
def test_what_a_call_needs_is_tried_if_it_mostly_fits() -> None:
    clock = _clock(1.0, judging=[0.1, 0.1, 0.1, 5.0])
    assert not clock.has_room("judging") and clock.may_do("judging")
    assert not _clock(1.0, judging=[0.1, 5.0, 5.0]).may_do("judging")
    assert not _clock(-1.0, judging=[0.1]).may_do("judging")


def test_what_is_kept_follows_what_was_measured(still: SimpleNamespace) -> None:
    slow, quick = (_clock(1.0, judging=[x], timing=[x], ending=[0.0]) for x in (0.1, 0.001))
    assert slow.reserve(10.0) == pytest.approx(0.4)
    assert quick.reserve(10.0) == pytest.approx(0.1) and quick.reserve(0.01) == pytest.approx(0.004)
    assert slow.reserve(0.1) < 0.1  # something is left to search
    assert slow.reserve(10.0, insured=True) == pytest.approx(0.2)  # one more motion, and the judge
    with quick.measured("timing"):
        still.now += 0.02
    assert quick.paces.longest("timing") == pytest.approx(0.02)
    endless = Clock()
    endless.ended(-np.inf)
    assert endless.paces.longest("ending") == 0.0


@pytest.mark.usefixtures("still")
@pytest.mark.parametrize(("left", "plenty", "insured"), [(0.1, False, False), (0.3, False, True), (0.5, True, True)])
def test_who_has_a_motion_begins_another_later(left, plenty, insured) -> None:
    clock = _clock(left, judging=[0.1], timing=[0.1])
    assert clock.has_plenty("timing", "judging") is plenty
    assert clock.has_plenty("timing", "judging", insured=True) is insured


def test_paces_are_those_of_the_scene(task) -> None:
    gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50, time_limit=LIMIT)
    paces = paces_of(task.scene)
    assert paces.longest("judging") > 0.0 and paces.longest("timing") > 0.0
    assert paces_of(task.scene) is paces


def test_what_cannot_be_judged_in_time_is_a_timeout_with_the_path(task, monkeypatch: pytest.MonkeyPatch) -> None:
    judged = []
    monkeypatch.setattr(finish, "verdict_of", lambda *_: judged.append(1))
    paces = paces_of(task.scene)
    try:
        for _ in range(16):
            paces.took("judging", 100.0)
        result = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50, time_limit=LIMIT)
    finally:
        for _ in range(16):
            paces.took("judging", 0.01)
    assert not judged
    assert result.status is PlanStatus.TIMEOUT and "NOT verified" in result.detail
    assert result.trajectory is None and not result.verdict.passed
    assert result.path is not None
    np.testing.assert_allclose(result.path.q[0], task.start)
    with pytest.raises(gp.PlanningFailed):
        result.unwrap()


@pytest.mark.parametrize("exposure", ["length", "time"])
def test_a_machine_that_was_busy_for_a_moment_does_not_keep_calls_from_judging(task, exposure) -> None:
    paces = paces_of(task.scene)
    try:
        for seconds in (*[0.01] * 15, 1.3 * LIMIT):
            paces.took("judging", seconds)
        objective = gp.Objective(exposure=exposure)
        result = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=100, time_limit=LIMIT)
    finally:
        for _ in range(16):
            paces.took("judging", 0.01)
    assert result.status is PlanStatus.SOLVED, result.detail


def test_a_first_motion_is_there_if_what_follows_comes_too_late(
    task, monkeypatch: pytest.MonkeyPatch, skipped: list[float]
) -> None:
    """As on a machine that stands still while motions are timed."""

    def late(*args: object) -> tuple[list[object], str]:
        skipped.append(LIMIT)
        return [], ""

    monkeypatch.setattr(searched, "motions", late)
    _learn(monkeypatch, judging=0.01, timing=0.01)
    result = gp.plan(task.start, task.goal, task.scene, w=0.3, iterations=100, time_limit=LIMIT)
    assert skipped and result.status is PlanStatus.SOLVED, result.detail
    assert result.verdict.passed and gp.verify(result.trajectory, task.scene).passed


def test_time_is_kept_to_judge_what_is_better_than_a_first_motion(
    task, monkeypatch: pytest.MonkeyPatch, skipped: list[float]
) -> None:
    """Where judging takes longer than anybody knew, and the first motion is the first to be judged."""
    judged: list[float] = []
    given: list[float] = []
    verify, motions, takes = finish.verify, searched.motions, 0.1 * LIMIT

    def slow(motion: gp.Trajectory, *args: object, **kwargs: object) -> object:
        judged.append(motion.duration)
        skipped.append(takes)
        return verify(motion, *args, **kwargs)

    def timed(found: object, request: object, ends: object, problem: object, means: tuple[Budget, object], *more):
        given.append(means[0].time_limit)
        return motions(found, request, ends, problem, means, *more)

    monkeypatch.setattr(finish, "verify", slow)
    monkeypatch.setattr(searched, "motions", timed)
    _learn(monkeypatch, judging=0.01, timing=0.01)
    result = gp.plan(task.start, task.goal, task.scene, w=0.3, iterations=100, time_limit=LIMIT)
    assert len(judged) == 2 and result.unwrap().duration == judged[1]
    assert 0.5 * LIMIT < given[0] <= LIMIT - takes  # descents leave so much to the judge


def _learn(monkeypatch: pytest.MonkeyPatch, **steps: float) -> None:
    """Let the next call know how long steps take [s]; what it learns itself no other test sees."""
    paces = Paces()
    for step, seconds in steps.items():
        for _ in range(16):
            paces.took(step, seconds)  # type: ignore[arg-type]
    monkeypatch.setattr(sys.modules["graceful_plan.plan"], "paces_of", lambda _: paces)


def test_a_pose_that_cannot_be_looked_for_in_time_is_a_timeout(task) -> None:
    away = PoseGoal.at([3.0, 0.0, 0.5])
    found = find_ends(task.start, away, _nothing_held(task), np.random.default_rng(0), late=lambda _: True)
    assert found.status is PlanStatus.TIMEOUT
    found = find_ends(task.start, away, _nothing_held(task), np.random.default_rng(0))
    assert found.status is PlanStatus.INVALID_GOAL


def _nothing_held(task: gp.Task) -> SceneConstraints:
    return SceneConstraints(task.scene, ())

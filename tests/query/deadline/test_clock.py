"""Steps are begun if they fit, what they take is learnt, and what cannot be judged in time is not called solved."""

from __future__ import annotations

import sys
import time

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.query import finish
from graceful_plan.query.answers import searched
from graceful_plan.query.deadline.clock import Clock, Paces, paces_of
from graceful_plan.query.ends import find_ends
from graceful_plan.result import PlanStatus
from graceful_plan.scene.pose_goal import PoseGoal


def _clock(seconds: float, **steps: list[float]) -> Clock:
    paces = Paces()
    for step, runs in steps.items():
        for run in runs:
            paces.took(step, run)  # type: ignore[arg-type]
    return Clock(time.perf_counter() + seconds, paces)


def test_there_is_room_for_what_ends_in_time() -> None:
    assert _clock(10.0, judging=[1.0, 2.0, 3.0], timing=[1.0]).has_room("timing", "judging")
    assert not _clock(3.5, judging=[1.0, 2.0, 3.0], timing=[1.0]).has_room("timing", "judging")
    assert not _clock(0.0, judging=[0.1]).has_room("judging")
    assert Clock().has_room("timing", "judging")


def test_somebody_has_to_try() -> None:
    """Before there are any runs nothing is known that would be against one, but time is kept for it."""
    assert _clock(-1.0).has_room("judging") and _clock(-1.0, timing=[1.0]).has_room("timing", "judging")
    assert 0.01 < _clock(1.0).reserve(1.0) < 0.2


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


def test_what_a_call_needs_is_tried_if_it_mostly_fits() -> None:
    clock = _clock(1.0, judging=[0.1, 0.1, 0.1, 5.0])
    assert not clock.has_room("judging") and clock.may_do("judging")
    assert not _clock(1.0, judging=[0.1, 5.0, 5.0]).may_do("judging")
    assert not _clock(-1.0, judging=[0.1]).may_do("judging")


def test_what_is_kept_follows_what_was_measured() -> None:
    slow, quick = (_clock(1.0, judging=[x], timing=[x], ending=[0.0]) for x in (0.1, 0.001))
    assert slow.reserve(10.0) == pytest.approx(0.4)
    assert quick.reserve(10.0) == pytest.approx(0.1) and quick.reserve(0.01) == pytest.approx(0.004)
    assert slow.reserve(0.1) < 0.1  # something is left to search
    with quick.measured("timing"):
        time.sleep(0.02)
    assert quick.paces.longest("timing") >= 0.02
    endless = Clock()
    endless.ended(-np.inf)
    assert endless.paces.longest("ending") == 0.0


def test_paces_are_those_of_the_scene(task) -> None:
    gp.plan(task.start, task.goal, task.scene, w=0.0, time_limit=10.0, callback=lambda _: True)
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
        result = gp.plan(task.start, task.goal, task.scene, w=0.0, time_limit=3.0)
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
        for seconds in (*[0.01] * 15, 2.0):
            paces.took("judging", seconds)
        result = gp.plan(task.start, task.goal, task.scene, objective=gp.Objective(exposure=exposure), time_limit=1.5)
    finally:
        for _ in range(16):
            paces.took("judging", 0.01)
    assert result.status is PlanStatus.SOLVED, result.detail


def test_a_first_motion_is_there_if_what_follows_comes_too_late(task, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine that stands still while motions are timed."""

    def late(*args: object) -> tuple[list[object], str]:
        time.sleep(1.0)
        return [], ""

    monkeypatch.setattr(searched, "motions", late)
    paces = paces_of(task.scene)
    for _ in range(16):
        paces.took("judging", 0.01)
        paces.took("timing", 0.01)
    result = gp.plan(task.start, task.goal, task.scene, w=0.3, time_limit=1.0)
    assert result.status is PlanStatus.SOLVED, result.detail
    assert result.verdict.passed and gp.verify(result.trajectory, task.scene).passed


def test_time_is_kept_to_judge_what_is_better_than_a_first_motion(task, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where judging takes longer than anybody knew, and the first motion is the first to be judged."""
    judged: list[float] = []
    verify = finish.verify

    def slow(motion: gp.Trajectory, *args: object, **kwargs: object) -> object:
        judged.append(motion.duration)
        time.sleep(0.3)
        return verify(motion, *args, **kwargs)

    monkeypatch.setattr(finish, "verify", slow)
    paces = Paces()
    for _ in range(16):
        paces.took("judging", 0.01)
        paces.took("timing", 0.01)
    monkeypatch.setattr(sys.modules["graceful_plan.plan"], "paces_of", lambda _: paces)
    result = gp.plan(task.start, task.goal, task.scene, w=0.3, time_limit=3.0)
    assert len(judged) == 2 and result.unwrap().duration == judged[1]


def test_a_pose_that_cannot_be_looked_for_in_time_is_a_timeout(task) -> None:
    away = PoseGoal.at([3.0, 0.0, 0.5])
    found = find_ends(task.start, away, _nothing_held(task), np.random.default_rng(0), late=lambda _: True)
    assert found.status is PlanStatus.TIMEOUT
    found = find_ends(task.start, away, _nothing_held(task), np.random.default_rng(0))
    assert found.status is PlanStatus.INVALID_GOAL


def _nothing_held(task: gp.Task) -> SceneConstraints:
    return SceneConstraints(task.scene, ())

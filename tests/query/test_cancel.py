"""Cancelling and interrupting `plan`: a verified path or the right status at any moment, and no damage."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.query.arguments import checked_cancelled
from graceful_plan.scene.pose_goal import PoseGoal

_ENDLESS: dict[str, Any] = {"time_limit": 60.0, "seed": 3}
"""Much more time than any test waits; an earlier result was cancelled."""


@pytest.fixture(scope="module")
def pose(task: gp.Task) -> PoseGoal:
    data = task.scene.data_at(task.goal[0])
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = data.site(task.scene.tool).xmat.reshape(3, 3), data.site(task.scene.tool).xpos
    return PoseGoal(X)


class After:
    """Returns False a number of times, then True."""

    def __init__(self, questions: int) -> None:
        self.left = questions
        self.asked = 0

    def __call__(self) -> bool:
        self.asked += 1
        return self.asked > self.left


def _check(result: gp.PlanResult, task: gp.Task, goal: Any) -> None:
    if result.status is gp.PlanStatus.SOLVED:
        assert gp.verify(result.unwrap(), task.scene, start=task.start, goal=goal).passed
    else:
        assert result.status is gp.PlanStatus.CANCELLED
        assert result.trajectory is None


@pytest.mark.parametrize("planner", ["anytime", "rrt_connect", "prm_star"])
def test_cancelled_at_any_question_it_is_honest(task: gp.Task, pose: PoseGoal, planner: str):
    statuses = []
    for questions in (0, 1, 2, 5, 9, 12, 17, 30):
        cancelled = After(questions)
        result = gp.plan(task.start, pose, task.scene, planner=planner, cancelled=cancelled, **_ENDLESS)
        _check(result, task, pose)
        # After True it is called at most once more.
        assert cancelled.asked <= questions + 1
        statuses.append(result.status)
    assert statuses[0] is gp.PlanStatus.CANCELLED


@pytest.mark.long
def test_cancelled_at_random_moments(task: gp.Task, pose: PoseGoal):
    rng = np.random.default_rng(0)
    statuses = set()
    for moment in rng.uniform(0.0, 0.4, size=20):
        event = threading.Event()
        timer = threading.Timer(moment, event.set)
        timer.start()
        result = gp.plan(task.start, pose, task.scene, cancelled=event.is_set, **_ENDLESS)
        timer.join()
        assert event.is_set()
        _check(result, task, pose)
        statuses.add(result.status)
    assert gp.PlanStatus.SOLVED in statuses


def test_a_cancelled_plan_is_smooth(task: gp.Task):
    """A coarse descent is always worth its millisecond, since polylines cost half as much again."""
    cancelled = After(40)
    result = gp.plan(task.start, task.goal, task.scene, w=0.3, cancelled=cancelled, **_ENDLESS)
    assert cancelled.asked == 41
    _check(result, task, task.goal)
    assert "estimated_total" in result.stats  # from the final descent


@pytest.mark.parametrize("settings", [{"risk": "cvar"}, {"w": 0.0}])
def test_every_stage_listens(task: gp.Task, settings: dict):
    goal = task.goal[0]
    for moment in (0.0, 0.01, 0.05):
        event = threading.Event()
        timer = threading.Timer(moment, event.set)
        timer.start()
        result = gp.plan(task.start, goal, task.scene, cancelled=event.is_set, **settings, **_ENDLESS)
        timer.join()
        _check(result, task, goal)


def test_cancelling_before_a_solution_has_its_status(task: gp.Task):
    result = gp.plan(task.start, task.goal[0], task.scene, cancelled=lambda: True)
    assert result.status is gp.PlanStatus.CANCELLED and "plan again" in result.status.value
    assert result.detail == "before the search"


def test_an_uncancelled_plan_equals_one_without_a_callback(task: gp.Task):
    first = gp.plan(task.start, task.goal, task.scene, iterations=60, seed=5)
    second = gp.plan(task.start, task.goal, task.scene, iterations=60, seed=5, cancelled=lambda: False)
    assert first.unwrap().q.tobytes() == second.unwrap().q.tobytes()


def test_an_error_of_the_question_reaches_the_caller(task: gp.Task):
    def broken() -> bool:
        raise RuntimeError("the button is gone")

    with pytest.raises(RuntimeError, match="the button is gone"):
        gp.plan(task.start, task.goal, task.scene, cancelled=broken)


def test_misuse_is_refused():
    with pytest.raises(SettingError, match="cancelled = True"):
        checked_cancelled(True)


def test_a_flickering_answer_counts_once():
    answers = iter([False, True, False])
    cancelled = checked_cancelled(lambda: next(answers))
    assert [cancelled(), cancelled(), cancelled(), cancelled()] == [False, True, True, True]


# --- Ctrl-C -----------------------------------------------------------------------------------------------------------


@contextmanager
def _interrupt_after(seconds: float) -> Iterator[None]:
    """Raise KeyboardInterrupt in this thread after a delay, as Ctrl-C does.

    It is raised twice: Python drops an interrupt that arrives while a weak reference is cleared.
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds, 0.05)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _fingerprint(task: gp.Task, planner: str) -> bytes:
    result = gp.plan(task.start, task.goal, task.scene, planner=planner, iterations=300, seed=9)
    return b"" if result.trajectory is None else result.trajectory.q.tobytes()


@pytest.mark.parametrize(
    ("planner", "count"),
    [("anytime", 5), *(pytest.param(name, 3, marks=pytest.mark.long) for name in ("rrt_star", "rrt_connect"))],
)
def test_interrupts_leave_nothing_broken(task: gp.Task, planner: str, count: int):
    expected = _fingerprint(task, planner)
    assert expected
    for moment in np.random.default_rng(1).uniform(0.001, 0.12, size=count):
        with pytest.raises(KeyboardInterrupt), _interrupt_after(float(moment)):
            gp.plan(task.start, task.goal, task.scene, planner=planner, **_ENDLESS)
            signal.pause()  # a planner that ends by itself is interrupted afterwards
    assert _fingerprint(task, planner) == expected


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # see `_interrupt_after`
def test_an_interrupt_while_the_scene_is_compiled(task: gp.Task):
    for moment in (0.001, 0.006, 0.015):
        fresh = task.scene.add_box("crate", [0.05, 0.05, 0.05], [0.6, 0.6, 0.05])
        with pytest.raises(KeyboardInterrupt), _interrupt_after(moment):
            gp.plan(task.start, task.goal, fresh, **_ENDLESS)
        assert isinstance(gp.clearance(task.start, fresh), np.ndarray | float)
        assert gp.plan(task.start, task.goal, fresh, iterations=60).status is gp.PlanStatus.SOLVED

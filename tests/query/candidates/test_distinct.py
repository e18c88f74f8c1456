"""Candidates of a call: distinct verified motions that the search meets anyway."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.query.candidates.distinct import APART, DistinctPaths

ITERATIONS = 400


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("tabletop").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def several(task: gp.Task) -> gp.PlanResult:
    return gp.plan(task.start, task.goal, task.scene, iterations=ITERATIONS, candidates=6)


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest distance at equal shares of the lengths, from 33 points."""
    even = []
    for q in (a, b):
        arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1)))
        s = np.linspace(0.0, arc[-1], 33)
        even.append(np.stack([np.interp(s, arc, column) for column in q.T], axis=1))
    return float(np.linalg.norm(even[0] - even[1], axis=1).max())


def test_paths_are_compared_at_equal_shares_of_their_lengths() -> None:
    straight = np.array([[0.0, 0.0], [1.0, 0.0]])
    dense = np.stack([np.linspace(0.0, 1.0, 50) ** 2, np.zeros(50)], axis=1)
    paths = DistinctPaths()
    assert paths.has_none_like(straight)
    paths.add(straight)
    assert not paths.has_none_like(dense), "other samples of the same path"
    for height, apart in ((0.2, False), (0.99 * APART, False), (1.01 * APART, True)):
        assert paths.has_none_like(np.array([[0.0, 0.0], [0.5, height], [1.0, 0.0]])) == apart
    paths.add(straight + [0.0, 1.0])
    assert not paths.has_none_like(dense + [0.0, 0.9])


def test_candidates_are_verified_and_distinct(several: gp.PlanResult, task: gp.Task) -> None:
    found = several.candidates
    assert 2 <= len(found) <= 6
    assert found[0].trajectory is several.trajectory
    assert all(one.status is gp.PlanStatus.SOLVED and one.verdict.passed for one in found)
    assert min(distance(a.path.q, b.path.q) for a, b in combinations(found, 2)) >= APART
    totals = [one.cost.total for one in found]
    assert totals[0] == min(totals) and max(totals) < 2.5 * min(totals)
    for one in found:
        assert gp.verify(one.trajectory, task.scene, start=task.start).passed
        assert gp.evaluate(one.trajectory, task.scene).total == pytest.approx(one.cost.total, rel=1e-6)


def test_the_motion_is_that_of_a_call_for_one(several: gp.PlanResult, task: gp.Task) -> None:
    one = gp.plan(task.start, task.goal, task.scene, iterations=ITERATIONS)
    assert one.candidates == ()
    np.testing.assert_array_equal(one.trajectory.q, several.trajectory.q)


def test_the_same_seed_gives_the_same_candidates(several: gp.PlanResult, task: gp.Task) -> None:
    again = gp.plan(task.start, task.goal, task.scene, iterations=ITERATIONS, candidates=6)
    fewer = gp.plan(task.start, task.goal, task.scene, iterations=ITERATIONS, candidates=2)
    assert len(again.candidates) == len(several.candidates) and len(fewer.candidates) == 2
    for first, second in zip(several.candidates, again.candidates, strict=True):
        np.testing.assert_array_equal(first.trajectory.q, second.trajectory.q)


def test_candidates_take_no_time_beyond_the_limit(task: gp.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    from graceful_plan.query import answer

    judged, calls = answer.judged, []
    monkeypatch.setattr(answer, "judged", lambda *args: calls.append(1) or judged(*args))
    late = property(lambda self: self._best is not None)
    monkeypatch.setattr(answer.BestVerified, "_late", late)
    found = gp.plan(task.start, task.goal, task.scene, iterations=100, candidates=6)
    assert len(calls) == 1, "nothing is verified after the time is over"
    assert len(found.candidates) == 1


def test_a_start_outside_of_a_limit_is_led_back_by_every_candidate(task: gp.Task) -> None:
    start = np.array(task.start)
    start[5] = task.scene.limits.position[5, 1] + 0.002
    found = gp.plan(start, task.goal, task.scene, iterations=300, candidates=4)
    assert found.status is gp.PlanStatus.SOLVED
    for one in found.candidates:
        np.testing.assert_allclose(one.trajectory.q[0], start)


@pytest.mark.parametrize("planner", ["rrt_connect", "auto"])
def test_without_refinement_candidates_are_earlier_improvements(task: gp.Task, planner: str) -> None:
    found = gp.plan(
        task.start, task.goal, task.scene, planner=planner, refine=False, iterations=500, candidates=4, w=1.0
    )
    assert 1 <= len(found.candidates) <= 4
    assert found.candidates[0].trajectory is found.trajectory


def test_a_failed_call_has_no_candidates(task: gp.Task) -> None:
    found = gp.plan(np.full(7, 9.0), task.goal, task.scene, iterations=10, candidates=3)
    assert found.status is gp.PlanStatus.INVALID_START and found.candidates == ()


@pytest.mark.parametrize("wrong", [0, -1, True, 65])
def test_misuse_is_refused(task: gp.Task, wrong: object) -> None:
    with pytest.raises(SettingError):
        gp.plan(task.start, task.goal, task.scene, iterations=10, candidates=wrong)


def test_candidates_and_via_exclude_each_other(task: gp.Task) -> None:
    with pytest.raises(SettingError):
        gp.plan(task.start, task.goal, task.scene, via=[task.start], iterations=10, candidates=2)

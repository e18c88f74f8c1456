"""Rounds of candidates and the best verified motion of a call: order of attempts, and the end of a call."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.planners.planner import Budget
from graceful_plan.query import answer as answer_module
from graceful_plan.query.arguments import checked_flag, checked_stop
from graceful_plan.query.candidates.candidates import rounds
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.request import Request
from graceful_plan.query.verification import VerifiedMotion
from graceful_plan.result import Check, PlanStatus, Verdict

LIMIT = 60.0
"""Seconds for plans that take some tenths of a second: `iterations` end them, also on a busy machine."""


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("tabletop").tasks["green_to_blue"]


def _spent(iterations: int, *, restarts: bool = True) -> list[int]:
    budget, given = Budget(iterations=iterations), []
    for part in rounds(budget, restarts=restarts):
        given.append(int(part.remaining_iterations))
        part.spend(given[-1])
    return given


def test_each_round_has_twice_the_work_of_the_one_before_and_the_last_takes_the_rest() -> None:
    assert _spent(1000) == [60, 120, 240, 580]
    assert _spent(100) == [100] and _spent(0) == []
    assert _spent(1000, restarts=False) == [1000]
    for budget in (300, 777, 5000):
        given = _spent(budget)
        assert sum(given) == budget
        longer = _spent(10 * budget)
        assert longer[: len(given) - 1] == given[:-1], "a longer call begins like a shorter one"


def test_rounds_end_where_a_search_has_given_up() -> None:
    assert len(list(rounds(Budget(iterations=1000)))) == 1


def test_rounds_of_a_time_limit_fill_it(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    given = []
    for part in rounds(Budget(1.0, started=0.0)):
        given.append(part.remaining_seconds)
        now[0] += part.remaining_seconds
    assert sum(given) == pytest.approx(1.0)
    np.testing.assert_allclose(np.array(given[1:-1]) / given[:-2], 2.0)


def test_the_first_round_has_the_given_length(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "perf_counter", lambda: 0.0)
    assert next(rounds(Budget(1.0, started=0.0), 0.01)).remaining_seconds == pytest.approx(0.01)


# --- when a call ends -------------------------------------------------------------------------------------------------


def test_the_first_verified_motion_ends_a_call_that_wants_no_more(task: gp.Task) -> None:
    told: list[gp.TracePoint] = []
    first = gp.plan(task.start, task.goal, task.scene, iterations=10_000, stop="first", callback=told.append)
    assert first.status is PlanStatus.SOLVED and first.stats["rounds"] == 0
    assert len(told) == 2 and told[-1].total == first.cost.total == first.stats["first_motion_cost"]
    stopped = gp.plan(task.start, task.goal, task.scene, iterations=10_000, callback=lambda point: True)
    np.testing.assert_array_equal(stopped.unwrap().q, first.unwrap().q)


def test_more_work_is_never_worse_than_the_first_motion(task: gp.Task) -> None:
    totals = []
    for iterations in (1, 40, 150):
        result = gp.plan(task.start, task.goal, task.scene, iterations=iterations, seed=2)
        totals.append(result.cost.total)
        assert result.cost.total <= result.stats["first_motion_cost"]
    assert totals[-1] <= totals[0]


def test_once_the_time_is_up_no_further_motion_is_verified(task: gp.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, late, looks = time.perf_counter, [0.0], list[Motion]()

    def refused(motion: Motion, request: Request) -> VerifiedMotion:
        looks.append(motion)
        late[0] = 2.0 * LIMIT
        return VerifiedMotion(motion=motion, verdict=Verdict(checks={"collision": Check()}))

    monkeypatch.setattr(answer_module, "judged", refused)
    monkeypatch.setattr(time, "perf_counter", lambda: clock() + late[0])
    assert gp.plan(task.start, task.goal, task.scene, time_limit=LIMIT).status is PlanStatus.TIMEOUT
    assert len(looks) == 1


def test_a_call_that_has_converged_ends_before_its_budget(task: gp.Task) -> None:
    result = gp.plan(task.start, task.goal, task.scene, iterations=50_000, stop="converged")
    assert result.status is PlanStatus.SOLVED
    assert result.stats["rounds"] >= 2 and result.stats["iterations"] < 50_000
    again = gp.plan(task.start, task.goal, task.scene, iterations=50_000, stop="converged")
    np.testing.assert_array_equal(again.unwrap().q, result.unwrap().q)


def test_a_straight_motion_at_zero_weight_ends_the_call() -> None:
    scene = gp.load_scene("tabletop")
    start = scene.keyframes["ready"]
    result = gp.plan(start, start + 0.05, scene, w=0.0, iterations=50_000)
    assert result.status is PlanStatus.SOLVED and result.stats["rounds"] == 0
    assert result.cost.motion == pytest.approx(np.linalg.norm(np.full(len(start), 0.05)), rel=1e-3)


def test_misuse_names_the_setting() -> None:
    assert checked_stop(None, limited=True) == "time_limit" and checked_stop(None, limited=False) == "converged"
    for stop in ("soon", 1):
        with pytest.raises(UnknownNameError, match="converged, first, time_limit"):
            checked_stop(stop, limited=True)
    for refine in ("yes", None, 1):
        with pytest.raises(SettingError, match="refine = "):
            checked_flag("refine", refine)


# --- results ----------------------------------------------------------------------------------------------------------


def test_without_refinement_the_motion_follows_the_planners_path(task: gp.Task) -> None:
    asked = {"planner": "rrt_connect", "iterations": 150, "seed": 3, "w": 0.3}
    own = gp.plan(task.start, task.goal, task.scene, refine=False, **asked)
    refined = gp.plan(task.start, task.goal, task.scene, **asked)
    assert own.status is refined.status is PlanStatus.SOLVED
    assert refined.cost.total < own.cost.total
    vertices = own.path.q
    away = np.linalg.norm(own.unwrap().sample(0.01).q[:, None] - _along(vertices)[None], axis=2).min(axis=1)
    assert away.max() < 0.11, "corners are cut by at most 0.1 rad"
    assert own.verdict.passed and gp.verify(own.trajectory, task.scene).passed


def _along(vertices: np.ndarray) -> np.ndarray:
    return np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(vertices)])


def test_a_first_motion_is_there_if_all_that_follows_is_refused(task: gp.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    passed: list[int] = []
    real = answer_module.judged

    def strict(motion, request):
        found = real(motion, request)
        if not passed:
            passed.append(1)
            return found
        return answer_module.VerifiedMotion(motion=motion, verdict=Verdict(checks={"mood": Check(passed=False)}))

    monkeypatch.setattr(answer_module, "judged", strict)
    result = gp.plan(task.start, task.goal, task.scene, iterations=100)
    assert result.status is PlanStatus.SOLVED and result.cost.total == result.stats["first_motion_cost"]


def test_always_refused_plans_are_unsolved_with_the_reason(task: gp.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    refusal = Verdict(checks={"mood": Check(passed=False, detail="bad")})
    monkeypatch.setattr(
        answer_module, "judged", lambda motion, request: answer_module.VerifiedMotion(motion=motion, verdict=refusal)
    )
    result = gp.plan(task.start, task.goal, task.scene, iterations=100)
    assert result.status is PlanStatus.TIMEOUT and result.trajectory is None
    assert "mood: bad" in result.detail and result.verdict is refusal


def test_the_reserve_is_the_time_of_the_last_steps(task: gp.Task, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the judge takes a fifth of the time, a second verdict that would be late is not begun."""
    skipped: list[float] = []
    clock, real = time.perf_counter, answer_module.judged
    monkeypatch.setattr(time, "perf_counter", lambda: clock() + sum(skipped))

    def slow(motion, request):
        skipped.append(0.6 * LIMIT)
        return real(motion, request)

    monkeypatch.setattr(answer_module, "judged", slow)
    result = gp.plan(task.start, task.goal, task.scene, iterations=300, time_limit=LIMIT)
    assert result.status is PlanStatus.SOLVED and len(skipped) == 1


def test_a_callback_that_stops_late_ends_the_call_at_once(task: gp.Task) -> None:
    """Rounds get longer, and the call must not wait for the current one."""
    told: list[gp.TracePoint] = []

    def third(point: gp.TracePoint) -> bool:
        told.append(point)
        return len(told) >= 3

    result = gp.plan(task.start, task.goal, task.scene, time_limit=LIMIT, seed=1, callback=third)
    # The other thread may have a better motion by then, of which the callback is no longer told.
    assert len(told) == 3 and result.cost.total <= told[-1].total
    assert result.stats["total_time"] < 0.5 * LIMIT

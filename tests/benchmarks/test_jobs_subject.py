"""The benchmark `jobs`: drawn variants are reproducible and bounded, and simple orders are what their names say."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.jobs.runs import ACTIONS_EACH, BLIND_ORDER, OURS, Measured, Way, fragile_last, nearest_first
from benchmarks.jobs.variants import ALL, FACTOR, GOAL_SHIFT, LARGER, SHIFT, standing, variant
from benchmarks.subjects.jobs import less, targets

import graceful_plan as gp
from graceful_plan.job.job_planning import JobSession
from graceful_plan.job.job_result import JobStatus
from graceful_plan.job.job_state import JobState, PoseKey, pose_of
from graceful_plan.job.motions import JobMotion, Motions, Refusal
from graceful_plan.job.placing import APART, nearer, occupant, overlapping, support_of
from graceful_plan.job.search import SequenceSearch


def _severity(scene: gp.Scene, body: str) -> float:
    return (scene.moving_severity[body] if body in scene.moving else scene.entities[body].severity)["body"]


@pytest.mark.parametrize("name", ALL)
def test_variants_are_drawn_within_bounds_and_again_alike(name: str) -> None:
    plain, drawn, again = variant(name, 0), variant(name, 1), variant(name, 1)
    ready = plain.scene.keyframes["ready"]
    for body in plain.goals:
        places = [one.scene.data_at(ready).body(body).xpos for one in (plain, drawn, again)]
        np.testing.assert_array_equal(places[1], places[2])
        assert 0.0 < np.abs(places[1] - places[0]).max() <= SHIFT
        assert 0.0 < np.abs(drawn.goals[body] - plain.goals[body]).max() <= GOAL_SHIFT
    for body in plain.kind.precious:
        severities = [_severity(one.scene, body) for one in (plain, drawn)]
        assert 1.0 / FACTOR <= severities[1] / severities[0] <= FACTOR and severities[0] != severities[1]
    assert set(drawn.job().goals) == {*plain.kind.goals, *plain.kind.on_tray}


@pytest.mark.parametrize("name", LARGER)
def test_the_arm_reaches_all_objects_of_larger_jobs_and_their_places(name: str) -> None:
    plain = variant(name, 0)
    assert 6 <= len(plain.goals) <= 8
    search = JobSession(plain.job(extras=False), gp.Objective(), grasps=1).search()
    for goal in search.goals:
        grasps = search.motions.grasps(search.start, goal.name, goal.poses(search.start))
        assert next(grasps, None) is not None, goal.name


@pytest.mark.parametrize("name", LARGER)
def test_places_of_larger_jobs_are_free(name: str) -> None:
    plain = variant(name, 0)
    at = {body: standing(plain.scene, body) for body in plain.goals}
    for body, X_WO in at.items():
        X_WO[:3, 3] = plain.goals[body]
    arrived = plain.scene.edit(move=at)
    for body in plain.goals:
        assert occupant(plain.scene, body, at[body]) is None
        assert occupant(arrived, body, at[body]) is None
        assert support_of(arrived, body) is not None


def test_simple_orders() -> None:
    order = variant("order", 0)
    assert fragile_last(order) == ("crate", "dome") and nearest_first(order)[0] == "crate"
    assert len(nearest_first(variant("tray", 0))) == 3
    assert len(nearest_first(variant("lay", 0))) == 8


def test_harm_is_compared_per_executed_job() -> None:
    ways = {OURS: Way(status="SOLVED", harm=2.0), BLIND_ORDER: Way(status="SOLVED", harm=5.0)}
    assert less(Measured(run={}, objects=1, ways=ways), BLIND_ORDER) == 2.5
    ways[OURS].harm = 0.0
    assert np.isnan(less(Measured(run={}, objects=1, ways=ways), BLIND_ORDER))


def _measured(job: str, objects: int, harm: dict[str, float]) -> Measured:
    ways = {name: Way(status="SOLVED", harm=value, duration=10.0) for name, value in harm.items()}
    return Measured(run={"job": job, "number": 0}, objects=objects, ways=ways, first_seconds=2.0, first_cpu=2.0)


def test_larger_jobs_have_targets_of_their_own() -> None:
    small = [_measured("order", 2, {OURS: 1.0, BLIND_ORDER: 2.0})]
    larger = [_measured("lay", 8, {OURS: 1.0, BLIND_ORDER: 1.2})]
    found = {target.what: target for target in targets(small, larger)}
    alone = {target.what: target for target in targets(small, [])}
    of_larger = [what for what in found if what.startswith("larger") or "8 objects" in what]
    assert {what: one for what, one in found.items() if what not in of_larger}.items() <= alone.items()
    assert all(alone[what].met is None for what in of_larger)
    median = next(found[what] for what in of_larger if "median" in what)
    assert median.met is False and found[of_larger[-1]].met is True


@pytest.mark.parametrize("name", LARGER)
def test_drawn_objects_do_not_overlap_and_their_places_are_apart(name: str) -> None:
    for number in range(4):
        drawn = variant(name, number)
        assert overlapping(drawn.scene, list(drawn.goals)) is None
        assert number == 0 or not list(nearer(drawn.scene.edit(move=drawn.goals), list(drawn.goals), APART))


def test_a_search_comes_back_from_a_dead_end_to_the_choice_that_caused_it(monkeypatch: pytest.MonkeyPatch) -> None:
    job, blocked = variant("lay", 0).job(extras=False), {}

    def carried(
        self: Motions, state: JobState, name: str, grasp: gp.Grasp, X_WO: PoseKey
    ) -> tuple[list[JobMotion], list[JobMotion], JobState] | Refusal:
        if blocked.get(name) in state.where:
            return Refusal(name=name, why="blocked", blockers=frozenset({blocked[name]}))
        return [self.still("transit", state.scene(), state.q)], [], state.moved(name, pose_of(X_WO))

    monkeypatch.setattr(Motions, "carried", carried)

    def order() -> tuple[SequenceSearch, list[str]]:
        search = JobSession(job, gp.Objective(w=0.0), grasps=1).search()
        search.run(lambda planned: search.best is not None or planned > 40)
        return search, [] if search.best is None else [name for _, name in search.best.actions]

    _, free = order()
    blocked[free[-1]] = free[0]
    search, found = order()
    assert len(found) == len(free) and found.index(free[-1]) < found.index(free[0])
    assert search.tried <= 2 * len(free)  # of the 5040 sequences that begin with the obstacle, one was followed


@pytest.mark.long
@pytest.mark.parametrize(("name", "number"), [("clear_desk", 1), ("groceries", 2), ("lay", 3)])
def test_drawn_larger_jobs_are_solved(name: str, number: int) -> None:
    one = variant(name, number)
    result = gp.plan_job(one.job(), 1.0, grasps=3, iterations=ACTIONS_EACH * one.objects, speed=0.5)
    assert result.status is JobStatus.SOLVED, result.detail


@pytest.mark.long
def test_larger_jobs_are_less_dear_than_in_the_order_of_severity() -> None:
    ratios = []
    for number in (0, 4):
        one = variant("clear_desk", number)
        ours = gp.plan_job(one.job(), 1.0, grasps=3, iterations=42, speed=0.5)
        given = ours.why(order=fragile_last(one), iterations=42).other
        assert ours.status is given.status is JobStatus.SOLVED
        ratios.append(ours.cost.total / given.cost.total)
    assert max(ratios) < 1.02 and np.prod(ratios) < 1.0

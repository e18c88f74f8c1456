"""Bases among those who move: laws of time against all there are, and whole plans."""

from itertools import product

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.mobile.among.pacing import SHARES, Charges, Pieces, cheapest_law
from graceful_plan.mobile.among.walkers import Walkers
from graceful_plan.mobile.query import answer
from graceful_plan.query.candidates.search import Search
from hall import hall

SCENE = hall(extra="").edit(remove=["person", "pillar"])
CROSSING = gp.MovingEntity(
    "ann", "adult", size=[0.25, 0.85], t=[0.0, 4.0], position=[[0.0, -1.6, 0.85], [0.0, 1.6, 0.85]], spread=0.05
)
"""Who is in the middle of the hall when a base that drives straight on at once gets there."""


def planned(scene, **given):
    given.setdefault("iterations", 300)
    return gp.plan("west", "east", scene, **given)


@pytest.mark.long
def test_laws_of_time_are_as_good_as_the_best_of_all():
    rng, n = np.random.default_rng(0), 3
    speed = np.array([1.0, 1.5, 1.0])
    pieces = Pieces(np.zeros((n, 3)), speed[:, None] * [1.0, 0.0, 0.0], 0.5 / speed, np.arange(n))
    free = 1e6  # acceleration: every share may follow every other
    for _ in range(10):
        still = 1.0 + rng.uniform(0.0, 1.0, (n, len(SHARES))) * SHARES
        moving = rng.uniform(0.0, 8.0, (n, 1, 60)) * (rng.uniform(size=(n, 1, 60)) < 0.3) * SHARES[:, None]
        charges = Charges(still, moving, np.zeros((n, 60), dtype=bool))

        def cost(shares, wait, charges=charges):
            total, t = float(charges.still.min()) * wait, wait
            for k, a in enumerate(shares):
                takes = pieces.seconds[k] / SHARES[a]
                total += takes * charges.second(k, a, np.array([t + 0.5 * takes]))[0]
                t += takes
            return total

        everything = product(product(range(len(SHARES)), repeat=n), np.arange(0.0, 0.51, 0.1))
        best = min(cost(shares, wait) for shares, wait in everything)
        share, wait = cheapest_law(pieces, charges, 0.5, free)
        found = cost([int(np.argmin(abs(SHARES - a))) for a in share], wait)
        assert best - 1e-9 <= found <= 1.03 * best


@pytest.mark.long
def test_a_motion_is_judged_before_the_search_that_takes_long(monkeypatch):
    searching, judging, judged = answer.search_among_walkers, answer.first_verified, []

    def late(request, *rest, **given):
        assert request.objective.w == 0.0 or judged[0].verdict.passed
        return searching(request, *rest, **given) if request.objective.w == 0.0 else Search()

    def first(*given):
        judged.append(judging(*given))
        return judged[-1]

    monkeypatch.setattr(answer, "search_among_walkers", late)
    monkeypatch.setattr(answer, "first_verified", first)
    result = planned(SCENE.with_moving(CROSSING), max_wait=3.0)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.passed and not result.verdict.warnings


@pytest.mark.long
def test_the_planner_over_cells_and_time_where_nobody_moves():
    result = planned(SCENE, planner="floor_in_time")
    assert result.status is gp.PlanStatus.SOLVED


def test_who_cancels_does_not_wait_for_all_looks_at_those_who_walk(monkeypatch):
    walkers = Walkers(gp.Objective().bind(SCENE.with_moving(CROSSING), (0.5, 1.0)))
    pieces = Pieces(np.zeros((2, 3)), np.array([[1.0, 0.0, 0.0]] * 2), np.ones(2), np.arange(2))
    looked, impact = [], Walkers.impact
    monkeypatch.setattr(Walkers, "impact", lambda *given: looked.append(1) or impact(*given))
    whole = Charges.of(pieces, walkers, 0.3, 0.0)
    several = len(looked)
    hasty = Charges.of(pieces, walkers, 0.3, 0.0, cancelled=lambda: True)
    assert len(looked) == several + 1 < 2 * several
    # At the fastest speed, where harm is most, it is what it was.
    np.testing.assert_array_equal(hasty.moving[:, 0], whole.moving[:, 0])
    np.testing.assert_array_equal(hasty.into, whole.into)


@pytest.mark.long
def test_nobody_is_driven_into_and_harm_is_less_than_without_regard_for_time():
    scene = SCENE.with_moving(CROSSING)
    unaware, aware = planned(SCENE), planned(scene)
    assert unaware.status is aware.status is gp.PlanStatus.SOLVED
    ran_over = gp.verify(unaware.trajectory, scene)
    assert ran_over.warnings == ("passing_by",) and ran_over.passed
    assert aware.verdict.checks["passing_by"].passed and "ann" in aware.verdict.checks["passing_by"].detail
    harm = gp.evaluate(unaware.trajectory, scene).impact_by_entity["ann"]
    assert aware.cost.impact_by_entity["ann"] < 0.2 * harm
    assert aware.trajectory.duration < unaware.trajectory.duration + 4.0
    assert gp.evaluate(aware.trajectory, scene).total == pytest.approx(aware.cost.total)


@pytest.mark.long
def test_who_is_far_away_changes_nothing_and_w_of_0_still_drives_into_nobody():
    far = gp.MovingEntity("ann", "adult", size=[0.25, 0.85], t=[0.0], position=[[30.0, 30.0, 0.85]])
    # Searches share 300 iterations in other ways, and one of them looks at cells: the motion may be a little better.
    alone, haunted = planned(SCENE), planned(SCENE.with_moving(far))
    assert haunted.trajectory.duration == pytest.approx(alone.trajectory.duration, rel=0.02)
    assert haunted.cost.total <= 1.01 * alone.cost.total
    ordinary = planned(SCENE.with_moving(CROSSING), w=0.0)
    assert ordinary.status is gp.PlanStatus.SOLVED and ordinary.verdict.checks["passing_by"].passed


@pytest.mark.long
def test_the_planner_over_cells_and_time_alone():
    result = planned(SCENE.with_moving(CROSSING), planner="floor_in_time")
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["passing_by"].passed


def test_who_cancels_does_not_wait_until_all_is_known_of_those_who_walk(monkeypatch):
    looked, moving_state = [], ImpactCost.moving_state
    monkeypatch.setattr(ImpactCost, "moving_state", lambda *given: looked.append(given) or moving_state(*given))
    scene = SCENE.with_moving(CROSSING)
    result = planned(scene, planner="floor_in_time", time_limit=600.0, iterations=None, cancelled=lambda: bool(looked))
    # What looks first is the motion along the way that is found as if nobody walked: it is looked at, charged and had.
    assert result.status is gp.PlanStatus.SOLVED and len(looked) == 1


@pytest.mark.long
def test_who_cannot_be_passed_is_named_in_a_warning():
    wall = gp.MovingEntity("crowd", "adult", size=[0.3, 9.0, 0.85], t=[0.0], position=[[0.0, 0.0, 0.85]])
    result = planned(SCENE.with_moving(wall), iterations=1000)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.warnings == ("passing_by",)
    assert "passing_by: drives into 'crowd'" in result.detail


def test_slopes_are_differences_of_impact():
    walkers = Walkers(gp.Objective().bind(SCENE.with_moving(CROSSING)))
    rng = np.random.default_rng(1)
    q = np.column_stack([rng.uniform(-2, -0.5, 200), rng.uniform(-0.5, 0.5, 200), rng.uniform(-0.3, 0.3, 200)])
    qd, t = np.tile([1.2, 0.0, 0.1], (200, 1)), np.full(200, 1.8)
    value, by_q, by_qd, by_t = walkers.slopes(q, qd, t)
    assert (value > 0.1).sum() > 30
    d, h = rng.normal(size=(200, 3)), 1e-4
    for slope, changed in (
        ((by_q * d).sum(axis=1), lambda s: walkers.impact(q + s * d, qd, t)),
        ((by_qd * d).sum(axis=1), lambda s: walkers.impact(q, qd + s * d, t)),
        (by_t, lambda s: walkers.impact(q, qd, t + s)),
    ):
        known = (changed(h) - changed(-h)) / (2 * h)
        assert np.mean(abs(slope - known) < 0.02 + 0.05 * abs(known)) >= 0.9  # it has kinks

"""Alternatives that the search rejected: other orders and actions, with the facts that decided."""

from __future__ import annotations

import math

import pytest
from order_jobs import job_scene, order_job, ordered

import graceful_plan as gp
from graceful_plan.job.motions import Refusal
from graceful_plan.job.rejected import ChosenSequence, Reason, SearchRecord
from graceful_plan.result import CostBreakdown

A, B, C = (("place", name) for name in "abc")


def cost(total: float) -> CostBreakdown:
    return CostBreakdown(motion=total, impact=0.0, w=1.0)


def chosen(*actions: tuple[str, str], total: float = 5.0, best: float = 6.0) -> ChosenSequence:
    return ChosenSequence(actions=actions, cost=cost(total), first=cost(best), best=best)


@pytest.mark.parametrize("w", [0.0, 3.0])
def test_the_other_order_costs_more_by_what_planning_it_tells(w: float) -> None:
    result = ordered(w)
    assert result.exhaustive
    (other,) = result.rejected
    assert other.reason is Reason.COSTLIER and other.is_complete and other.difference > 0.0
    assert other.actions == tuple(("place", name) for name in reversed(result.order))
    assert other.cost is not None and other.cost.w == w
    again = result.why(order=result.order[::-1], iterations=40)
    assert again.other.cost.total == pytest.approx(other.cost.total, rel=0.2)


def test_what_was_not_compared_in_time_is_told_with_its_bound() -> None:
    result = gp.plan_job(order_job(), 3.0, grasps=1, iterations=2)
    assert not result.exhaustive and result.rejected
    for one in result.rejected:
        assert one.reason in (Reason.UNFINISHED, Reason.BOUNDED) and one.lower_bound > 0.0 and not one.is_complete


def test_an_order_in_which_a_place_is_taken_is_refused_with_the_body_in_the_way() -> None:
    there = gp.Job(job_scene("order")).place("dome", at=[0.5, -0.2, 0.4]).place("crate", at=[0.5, 0.48, 0.4])
    result = gp.plan_job(there, 0.0, grasps=1, iterations=20)
    (one,) = result.rejected
    assert result.order == ("crate", "dome") and one.actions == (("place", "dome"),)
    assert one.reason is Reason.REFUSED and one.refusal is not None and one.refusal.blockers == {"crate"}


def test_a_goal_out_of_reach_is_an_alternative_with_its_cause() -> None:
    far = gp.Job(job_scene("order")).place("crate", at=[1.5, 0.0, 0.4])
    result = gp.plan_job(far, iterations=2)
    (one,) = result.rejected
    assert one.reason is Reason.REFUSED and one.actions == (("place", "crate"),)
    assert one.refusal is not None and one.refusal.why == result.detail


def test_each_outcome_has_its_reason() -> None:
    record = SearchRecord()
    record.reached((A,), cost(2.0), is_complete=False, is_new=True)
    record.reached((A, B), cost(6.0), is_complete=True, is_new=True)
    record.reached((B,), cost(2.0), is_complete=False, is_new=True)
    record.reached((B, A), cost(9.0), is_complete=True, is_new=False)
    record.reached((B, A), cost(8.0), is_complete=True, is_new=True)
    record.reached((C,), cost(2.0), is_complete=False, is_new=True)
    record.refused((B, C), Refusal(name="c", why="by this grasp"), 1.0)
    record.refused((B, C), Refusal(name="c", why="its place is taken", by_any_grasp=True), 1.0)
    record.refused((A, C), Refusal(name="c", why="no time", unsure=True), 3.0)
    record.bounded((A, A), 7.0)
    record.reached((B, B), cost(4.0), is_complete=False, is_new=False)
    found = {one.actions: one for one in record.rejected([((C, A), 2.5), ((C, B), 6.5)], chosen(A, B), {})}
    assert {actions: one.reason for actions, one in found.items()} == {
        (B, A): Reason.COSTLIER,
        (B, C): Reason.REFUSED,
        (A, C): Reason.UNFINISHED,
        (A, A): Reason.BOUNDED,
        (B, B): Reason.SAME_STATE,
        (C, A): Reason.UNFINISHED,
        (C, B): Reason.BOUNDED,
    }
    assert found[B, A].difference == pytest.approx(2.0)
    assert found[B, C].refused == 2 and "taken" in found[B, C].why
    assert found[C, A].lower_bound == 2.5 and math.isnan(found[C, A].difference)


def test_improved_motions_are_compared_with_improved_motions() -> None:
    record = SearchRecord()
    record.reached((A,), cost(6.0), is_complete=True, is_new=True)
    record.reached((B,), cost(8.0), is_complete=True, is_new=True)
    (one,) = record.rejected([], chosen(A, total=5.0, best=6.0), {(B,): cost(5.5)})
    assert one.difference == pytest.approx(0.5)


def test_an_action_after_which_nothing_is_possible_is_a_dead_end() -> None:
    record = SearchRecord()
    record.reached((A,), cost(2.0), is_complete=False, is_new=True)
    (one,) = record.rejected([], None, {})
    assert one.reason is Reason.DEAD_END

"""Motions for simpler objectives compete with motions for the full one, and are their initial guesses."""

from __future__ import annotations

from dataclasses import replace

import pytest

import graceful_plan as gp
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.query.candidates.proxy_objective import proxy_objective
from sizes import first_quick

DROPS = gp.ImpactCost(model=gp.FailureMixture())
ARM = gp.ImpactCost(model=gp.FailureMixture(faults="service_robot"))


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("desk").tasks["return_stapler"]


@pytest.mark.parametrize(
    ("impact", "expected"),
    [
        (gp.ImpactCost(), None),
        (ARM, DROPS),
        (gp.ImpactCost(consequence="energy"), None),
        (gp.ImpactCost("box_overlap", consequence="energy"), DROPS),
    ],
)
def test_simpler_objectives(task: gp.Task, impact: gp.ImpactCost, expected: gp.ImpactCost | None) -> None:
    found = proxy_objective(Objective(impact=impact, w=0.7).bind(task.scene, search_paces(1.0)))
    assert (None if found is None else found.objective.impact) == expected
    assert found is None or found.objective.w == 0.7
    assert proxy_objective(Objective(impact=impact, w=0.0).bind(task.scene)) is None


@pytest.mark.long
@pytest.mark.parametrize("impact", first_quick([ARM, gp.ImpactCost("box_overlap", consequence="energy")]))
def test_a_full_plan_is_no_worse_than_its_simpler_one(task: gp.Task, impact: gp.ImpactCost) -> None:
    objective = gp.Objective(impact=impact)
    full = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=300, seed=1)
    share = gp.plan(task.start, task.goal, task.scene, iterations=195, seed=1)
    assert full.status is share.status is gp.PlanStatus.SOLVED
    assert full.cost is not None and full.trajectory is not None and share.trajectory is not None
    assert full.cost.total == pytest.approx(gp.evaluate(full.trajectory, task.scene, objective).total)
    assert full.cost.total <= 1.001 * gp.evaluate(share.trajectory, task.scene, objective).total
    again = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=300, seed=1)
    assert again.trajectory is not None
    assert again.trajectory.q.tobytes() == full.trajectory.q.tobytes()


def test_a_custom_cost_starts_from_the_shortest_path(task: gp.Task) -> None:
    class Nothing(gp.Cost):
        name = "nothing"

        def state(self, batch):
            return 0.0 * batch.q[:, 0]

    objective = gp.Objective(impact=Nothing())
    found = proxy_objective(objective.bind(task.scene))
    assert found is not None and found.w == 0.0
    short = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=200)
    own = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=200)
    assert own.cost is not None and short.cost is not None
    assert own.cost.total <= 1.05 * short.cost.total


def test_the_simpler_model_has_the_shipped_settings(task: gp.Task) -> None:
    bound = gp.Objective(impact=replace(ARM, own_loss=False)).bind(task.scene)
    found = proxy_objective(bound)
    assert found is not None and found.objective.impact == DROPS

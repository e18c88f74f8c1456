"""Motions for cheaper objectives compete with, and begin, those for costly ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.cheaper import cheaper, is_enough, known_motions
from graceful_plan.query.deadline.clock import Clock
from graceful_plan.query.ends import Ends, find_ends
from graceful_plan.query.request import Request
from sizes import first_quick

DROPS = gp.ImpactCost(model=gp.Footprint())
ARM = gp.ImpactCost(model=gp.Footprint(faults="service_robot"))


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("desk").tasks["return_stapler"]


@pytest.mark.parametrize(
    ("impact", "expected"),
    [
        (gp.ImpactCost(), None),
        (ARM, DROPS),
        (gp.ImpactCost(consequence="energy"), DROPS),
    ],
)
def test_what_is_cheaper(task: gp.Task, impact: gp.ImpactCost, expected: gp.ImpactCost | None) -> None:
    found = cheaper(Objective(impact=impact, w=0.7).bind(task.scene, search_paces(1.0)))
    assert (None if found is None else found.objective.impact) == expected
    assert found is None or found.objective.w == 0.7
    assert cheaper(Objective(impact=impact, w=0.0).bind(task.scene)) is None


@pytest.mark.long
@pytest.mark.parametrize("impact", first_quick([ARM, gp.ImpactCost(consequence="energy")]))
def test_a_costly_plan_is_no_worse_than_the_cheap_one_in_its_share(task: gp.Task, impact: gp.ImpactCost) -> None:
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


def test_a_cost_of_ones_own_begins_with_the_shortest(task: gp.Task) -> None:
    class Nothing(gp.Cost):
        name = "nothing"

        def state(self, batch):
            return 0.0 * batch.q[:, 0]

    objective = gp.Objective(impact=Nothing())
    found = cheaper(objective.bind(task.scene))
    assert found is not None and found.w == 0.0
    short = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=200)
    own = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=200)
    assert own.cost is not None and short.cost is not None
    assert own.cost.total <= 1.05 * short.cost.total


def test_settings_of_the_cheaper_model_are_the_shipped_ones(task: gp.Task) -> None:
    bound = gp.Objective(impact=replace(ARM, own_loss=False)).bind(task.scene)
    found = cheaper(bound)
    assert found is not None and found.objective.impact == DROPS


@pytest.mark.parametrize(
    ("of", "limit", "begins", "alone"),
    [
        ("dining_table/serve_stew", 5.0, True, False),
        ("dining_table/serve_stew", 1.0, True, True),
        ("dining_table/serve_stew", 0.3, False, False),
        ("desk/bring_coffee", np.inf, False, False),
    ],
)
def test_where_next_to_nothing_may_slop_over_the_shortest_motion_competes(
    of: str, limit: float, *, begins: bool, alone: bool
) -> None:
    scene, name = of.split("/")
    task = gp.load_scene(scene).tasks[name]
    objective = gp.Objective().bind(task.scene, search_paces(1.0))
    held = SceneConstraints(task.scene, default_constraints(task.scene))
    ends = find_ends(task.start, task.goal, held, np.random.default_rng(0))
    assert isinstance(ends, Ends)
    request = Request(
        planner=gp.Auto(), objective=objective, constraints=ends.constraints, clock=Clock(np.inf, limit=limit)
    )
    problem = SceneProblem(
        kernels=ends.constraints.kernels,
        start=ends.departure.q[-1],
        goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
        margin=0.001,
        constraints=ends.constraints,
    )
    known = known_motions(request, problem, ends, Budget(iterations=4), np.random.default_rng(1))
    assert bool(known) is begins
    assert (bool(known) and is_enough(request)) is alone
    for motion in known:
        assert motion.cost.total == pytest.approx(gp.evaluate(motion.trajectory, task.scene).total)

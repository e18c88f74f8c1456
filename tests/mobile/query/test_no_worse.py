"""Plans with w > 0 never cost more, by J, than plans with w = 0."""

import pytest

import graceful_plan as gp
from graceful_plan.mobile.floor.generated import floor_plan


@pytest.mark.long
@pytest.mark.parametrize("seed", [3])
def test_a_motion_costs_no_more_than_that_for_a_weight_of_0(seed):
    made = floor_plan(seed, rooms=(2, 1), people=8)
    scene, goal = made.floor.to_scene("jackal"), gp.BasePose(*made.goal[:2])
    plain, ours = (gp.plan(made.start, goal, scene, w=w, iterations=3000) for w in (0.0, 1.0))
    assert plain.status is ours.status is gp.PlanStatus.SOLVED
    assert ours.cost.total <= gp.evaluate(plain.trajectory, scene, gp.Objective(w=1.0)).total * (1.0 + 1e-9)

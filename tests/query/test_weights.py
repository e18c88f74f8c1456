"""More w never costs: by J at w, the plan for w is at least as good as plans for other weights."""

from __future__ import annotations

import pytest

import graceful_plan as gp
from sizes import first_quick

_LADDER = 0.0, 0.1, 0.3, 1.0, 3.0
_ROUNDING = 2e-3
"""Share of J by which a descent that ends early may miss."""


def _costs(scene: str, task: str, weights: tuple[float, ...]) -> dict[float, gp.CostBreakdown]:
    asked = gp.load_scene(scene).tasks[task]
    found = {w: gp.plan(asked.start, asked.goal, asked.scene, w=w, iterations=240, seed=0) for w in weights}
    assert all(result.cost.w == w for w, result in found.items())
    return {w: result.cost for w, result in found.items()}


def _j(cost: gp.CostBreakdown, w: float) -> float:
    return cost.motion + w * cost.impact


@pytest.mark.parametrize("task", first_quick(["far_to_near", "lift_to_goal", "green_to_blue", "right_to_left"]))
def test_no_plan_of_a_ladder_beats_that_for_its_weight(task: str) -> None:
    costs = _costs("tabletop", task, _LADDER)
    for w in _LADDER:
        assert _j(costs[w], w) <= (1.0 + _ROUNDING) * min(_j(cost, w) for cost in costs.values())
    motion, impact = ([getattr(costs[w], name) for w in _LADDER] for name in ("motion", "impact"))
    assert motion == sorted(motion) and impact == sorted(impact, reverse=True)


@pytest.mark.parametrize("task", first_quick(["bring_coffee", "put_book_away"]))
def test_no_plan_is_worse_than_the_shortest_motion(task: str) -> None:
    """Even where a full cup leaves searches far from the best motion."""
    costs = _costs("desk", task, (0.0, 0.3, 3.0))
    for w in (0.3, 3.0):
        assert _j(costs[w], w) <= (1.0 + _ROUNDING) * _j(costs[0.0], w)

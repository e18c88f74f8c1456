"""Points of a front of motion against impact; see `pareto_front`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.planners.roadmaps.graph import non_dominated
from graceful_plan.result import CostBreakdown, Verdict
from graceful_plan.timing.trajectory import Trajectory


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ParetoPoint:
    """A verified motion of a front.

    Args:
        path: Geometry of the motion.
        trajectory: The timed motion.
        cost: Cost recomputed from the trajectory.
        verdict: Verdict of the independent judge on the trajectory; passed.
        made_by: Method that found it. "descent": a smooth motion that minimises V + w S. For paths with rounded
            corners, "weight": a minimisation of V + w S; "gap": a minimisation between two neighbours; "roadmap": an
            exact search on a roadmap.
        made_with: The weight w; for a gap, the impact S to undercut.
        weights: Range of safety weights at which it has the least V + w S of the front; None if there are none.
    """

    path: Path
    trajectory: Trajectory
    cost: CostBreakdown
    verdict: Verdict
    made_by: str
    made_with: float
    weights: tuple[float, float] | None = None

    @property
    def motion(self) -> float:
        """Motion V."""
        return self.cost.motion

    @property
    def impact(self) -> float:
        """Impact S."""
        return self.cost.impact


def dominated_area(costs: Float[Array, "n 2"], reference: Float[Array, " 2"]) -> float:
    """Return the area that is dominated by the points and below the reference."""
    inside = costs[np.all(costs < reference, axis=1)]
    front = inside[non_dominated(inside)]
    right = np.append(front[1:, 0], reference[0])
    return float(np.sum((right - front[:, 0]) * (reference[1] - front[:, 1])))


def hull_weights(costs: Float[Array, "n 2"]) -> list[tuple[float, float] | None]:
    """Return the range of safety weights at which each point, sorted by motion, has the least V + w S, or None."""
    hull: list[int] = []
    for i in range(len(costs)):
        while len(hull) > 1 and _slope(costs, hull[-2], hull[-1]) >= _slope(costs, hull[-1], i):
            hull.pop()
        hull.append(i)
    between = [0.0, *(_slope(costs, a, b) for a, b in pairwise(hull)), np.inf]
    weights: list[tuple[float, float] | None] = [None] * len(costs)
    for k, i in enumerate(hull):
        weights[i] = (between[k], between[k + 1])
    return weights


def _slope(costs: Float[Array, "n 2"], a: int, b: int) -> float:
    """Return the weight at which two points have the same cost."""
    return float((costs[b, 0] - costs[a, 0]) / (costs[a, 1] - costs[b, 1]))


def front_of(points: Sequence[ParetoPoint]) -> tuple[ParetoPoint, ...]:
    """Return the non-dominated points sorted by motion, each with the range of weights that lead to it."""
    costs = np.array([(p.motion, p.impact) for p in points], dtype=np.float64).reshape(-1, 2)
    kept = non_dominated(costs)
    return tuple(replace(points[i], weights=w) for i, w in zip(kept.tolist(), hull_weights(costs[kept]), strict=True))

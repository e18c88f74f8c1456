"""State of an optimiser: its best path, random displacements of it, and blurred objectives."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.incumbent import Incumbent
from graceful_plan.planners.optimisers.smoothness import Smoothness
from graceful_plan.planners.planner import BoundObjective, WidenableObjective

JITTER = 1e-3
"""Displacement that breaks symmetries, at which the gradient is 0 [rad]."""


@final
class DescentState:
    """Shared state of the descents from one path.

    Args:
        path: Initial path.
        edges: Number of edges of the path during optimisation.
        slopes: Access to problem and objective.
    """

    def __init__(self, path: Path, edges: int, slopes: Slopes) -> None:
        self.slopes, self.budget = slopes, slopes.budget
        self.limits = slopes.problem.lower, slopes.problem.upper
        self.kept = Incumbent(path, edges, slopes)
        inner = max(1, len(self.kept.q) - 2)
        self.metric, self._bends = Smoothness(inner, 1), Smoothness(inner, 2)

    @property
    def movable(self) -> bool:
        """Whether there are points between the ends."""
        return len(self.kept.q) > 2

    def widened(self, widths: tuple[float, ...]) -> list[BoundObjective]:
        """Return the objective with places of impact blurred by each width [m]; empty if that is not possible."""
        objective = self.slopes.objective
        if not (objective.w > 0.0 and isinstance(objective, WidenableObjective)):
            return []
        return [wide for wide in map(objective.widened, widths) if wide is not None]

    def bent(self, size: float, rng: np.random.Generator) -> Float[Array, "point nq"]:
        """Return the best path with a smooth random displacement."""
        q = self.kept.q.copy()
        q[1:-1] += size * self._bends.noise(1, q.shape[1], rng)[0]
        q[1:-1] = self.metric.into_limits(q[1:-1], *self.limits)
        return q

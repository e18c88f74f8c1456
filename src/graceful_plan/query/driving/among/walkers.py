"""Moving entities around a base: what they make a failure cost at a time, and how close the sound robot comes to them.

Searches and smooth curves know the scene as if nobody moved, in the core; what those who move add is looked at here, at
the times at which the base gets there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.costs.cost import moving_batch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.costs.still import as_if_nobody_moved
from graceful_plan.judge.passing_by import is_moving
from graceful_plan.planners.driving.roughly import roughly
from graceful_plan.query.driving.among.balls import Balls
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

KEPT = 0.15
"""Clearance to people that is planned with [m]; the judge asks for more than none."""
_LOOKS = 200
"""At a motion."""


@dataclass(frozen=True, eq=False)
class Walkers:
    """Those who move.

    Args:
        objective: In a scene where somebody does.
    """

    objective: SceneObjective

    @cached_property
    def still(self) -> SceneObjective:
        """The objective as if nobody moved."""
        of = self.objective
        return SceneObjective(of.objective, as_if_nobody_moved(of.scene), of.paces)

    @cached_property
    def rough(self) -> SceneObjective:
        """The objective, close to it but much faster where a base fails, see `roughly`; without them if none counts."""
        of = self.objective
        if of.w == 0.0:
            return self.still
        if self._rough is None:
            return of
        return SceneObjective(replace(of.objective, impact=self._rough), of.scene, of.paces)

    def impact(self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"], t: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return about what they add to the impact of states at times; nothing by costs of one's own."""
        if self.objective.w == 0.0 or self._rough is None:
            return np.zeros(len(q))
        return self._rough.moving_state(moving_batch(self.objective.scene, q, qd, t))

    @cached_property
    def _rough(self) -> ImpactCost | None:
        cost = self.objective.objective.impact
        return roughly(cost) if isinstance(cost, ImpactCost) else None

    def slopes(
        self, q: Float[Array, "n nq"], qd: Float[Array, "n nq"], t: Float[Array, " n"]
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"], Float[Array, " n"]]:
        """Return `impact`, and its derivatives by configuration, by its velocities, and by time."""
        if self._moving is None:
            return np.zeros(len(q)), np.zeros_like(q), np.zeros_like(q), np.zeros(len(q))
        return self._moving.slopes(*(np.ascontiguousarray(given) for given in (q, qd, t)))

    def gap(self, q: Float[Array, "n nq"], t: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return how far the robot is from the nearest of them, as predicted [m]; see `Balls.gap`."""
        gaps = [self._balls.gap(q, entity, t) for entity in self.objective.scene.moving.values()]
        return np.min(gaps, axis=0)

    def meets(self, motion: Trajectory) -> bool:
        """Whether the sound robot comes close to drive into one of them."""
        t = motion.t[0] + motion.duration * np.linspace(0.0, 1.0, _LOOKS)
        state = motion.at(t)
        return bool((is_moving(state.qd) & (self.gap(state.q, t) < 0.5 * KEPT)).any())

    @cached_property
    def _moving(self) -> _native.MovingImpact | None:
        if self.objective.w == 0.0 or self._rough is None:
            return None
        return self._rough.moving_impact(self.objective.scene)

    @cached_property
    def _balls(self) -> Balls:
        return Balls(self.objective.scene)

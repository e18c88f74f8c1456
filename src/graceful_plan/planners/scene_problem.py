"""A planning problem in a scene, with native collision checks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.kernels import CHECK_STEP, Kernels
from graceful_plan.planners.planner import Problem


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class SceneProblem(Problem):
    """Problem of reaching any of several goals from a start in a scene.

    Args:
        kernels: Kernels of the constraints.
        start: Start, free and inside the limits [rad or m].
        goals: Goals, free and inside the limits [rad or m].
        check_step: Largest distance between checked configurations of an edge [rad]. The native planners check the
            edges of a path once more at `FINE_STEP`.
        margin: Clearance to keep [m].
        constraints: Constraints in addition to collision; None if there are none.
    """

    kernels: Kernels
    start: Float[Array, " nq"]
    goals: Float[Array, "goal nq"]
    check_step: float = CHECK_STEP
    margin: float = 0.0
    constraints: SceneConstraints | None = None

    @cached_property
    def lower(self) -> Float[Array, " nq"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Lower position limits; of a hinge, at most a turn below start and goals."""
        return np.maximum(self.kernels.robot.lower, self._ends.min(axis=0) - self._around)

    @cached_property
    def upper(self) -> Float[Array, " nq"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Upper position limits; of a hinge, at most a turn above start and goals."""
        return np.minimum(self.kernels.robot.upper, self._ends.max(axis=0) + self._around)

    @property
    def _ends(self) -> Float[Array, "end nq"]:
        return np.vstack([self.start, self.goals])

    @property
    def _around(self) -> Float[Array, " nq"]:
        """Distance around start and goals beyond which a joint meets no new configurations [rad or m]."""
        robot, around = self.kernels.robot, np.full(len(self.start), np.inf)
        turns = (robot.joint >= 0) & (robot.slide == 0)
        around[robot.joint[turns]] = 2.0 * np.pi
        return around

    def states_free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return which configurations are free of collision and satisfy the constraints."""
        free = self.kernels.free(q, self.margin)
        if self.custom is not None and np.any(free):
            free[free] = self.custom.custom_holds(q[free], self.margin)
        return free

    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return which straight edges are free of collision and satisfy the constraints."""
        free = self.kernels.edges_free(q0, q1, self.check_step, self.margin)
        if self.custom is not None and np.any(free):
            free[free] = edges_hold(self.custom, q0[free], q1[free], self.check_step, self.margin)
        return free

    def projected(self, q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Project configurations onto the native constraints by Newton's method."""
        return self.kernels.projected(q, self.margin)

    def clearance_gradient(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]]:
        """Return the clearance of the nearest pair beyond the margin [m], including self-pairs, and its gradient."""
        clearance, gradient = self.kernels.clearance_gradient(q)
        if self.custom is not None:
            own, slope = self.custom.custom_clearance(q)
            nearer = own < clearance
            clearance, gradient = np.where(nearer, own, clearance), np.where(nearer[:, None], slope, gradient)
        return clearance - self.margin, gradient

    @property
    def custom(self) -> SceneConstraints | None:
        """The constraints, if some of them are checked in Python; else None."""
        return self.constraints if self.constraints is not None and self.constraints.custom else None


def edges_hold(
    constraints: SceneConstraints, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float, margin: float
) -> Bool[Array, " n"]:
    """Return along which straight edges custom constraints hold, at configurations at most `step` [rad] apart."""
    pieces = np.ceil(np.linalg.norm(q1 - q0, axis=1) / step).astype(int) + 1
    edge = np.repeat(np.arange(len(q0)), pieces + 1)
    first = np.concatenate([[0], np.cumsum(pieces + 1)[:-1]]) if len(q0) else np.zeros(0, dtype=int)
    share = ((np.arange(len(edge)) - first[edge]) / pieces[edge])[:, None]
    holds = constraints.custom_holds((1.0 - share) * q0[edge] + share * q1[edge], margin)
    return np.logical_and.reduceat(holds, first) if len(q0) else np.zeros(0, dtype=bool)

"""A planning problem in a scene, on the native kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.kernels import CHECK_STEP, Kernels
from graceful_plan.planners.planner import Problem

Array = np.ndarray


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class SceneProblem(Problem):
    """From a start to one of several goals in a scene.

    Args:
        kernels: The scene's kernels.
        start: Start, free and inside the limits [rad or m].
        goals: Goals, free and inside the limits [rad or m].
        check_step: Largest distance between checked configurations of an edge [rad]. The native planners check the
            edges of a path once more at `FINE_STEP`.
        margin: Clearance to keep [m].
    """

    kernels: Kernels
    start: Float[Array, " nq"]
    goals: Float[Array, "goal nq"]
    check_step: float = CHECK_STEP
    margin: float = 0.0

    @property
    def lower(self) -> Float[Array, " nq"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Lower position limits."""
        return self.kernels.robot.lower

    @property
    def upper(self) -> Float[Array, " nq"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Upper position limits."""
        return self.kernels.robot.upper

    def states_free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Tell which configurations are free of collision."""
        return self.kernels.free(q, self.margin)

    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Tell which straight edges are free of collision."""
        return self.kernels.edges_free(q0, q1, self.check_step, self.margin)

    def clearance_gradient(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]]:
        """Return the clearance beyond the margin [m] of the nearest pair, self-collision included, and its gradient."""
        clearance, gradient = self.kernels.clearance_gradient(q)
        return clearance - self.margin, gradient

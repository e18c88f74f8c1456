"""The cost of straight moves from the start, by which goal configurations are compared before any search."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import StateBatch, checked_state
from graceful_plan.costs.motion import JointLength
from graceful_plan.costs.objective import SceneObjective

_STEP = 0.1
"""Largest distance between samples of a move [rad]."""
_SHORT = 1e-3
"""Length of the move along which the cost of a joint's motion is measured [rad or m]."""
_STIFFEST = 1e-3
"""Least ease of a joint."""


@final
@dataclass(frozen=True, eq=False)
class Travel:
    """Motion cost of straight moves from a start.

    Args:
        start: The start [rad or m].
        objective: Objective whose motion cost counts; by default the joint-space length does.
    """

    start: Float[Array, " nq"]
    objective: SceneObjective | None = None

    def cost(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the cost of the move to each configuration.

        Raises:
            CostError: If the motion cost breaks its contract.
        """
        motion = JointLength() if self.objective is None else self.objective.objective.motion
        if isinstance(motion, JointLength) or self.objective is None or not len(q):
            weights = motion.weights if isinstance(motion, JointLength) and motion.weights is not None else (1.0,)
            return np.linalg.norm((q - self.start) * np.array(weights), axis=1)
        samples = self.objective.samples(np.tile(self.start, (len(q), 1)), np.ascontiguousarray(q), _STEP)
        batch = StateBatch(self.objective.scene, samples.q, samples.direction, samples.speed)
        return samples.integral(checked_state(motion, batch), samples.length)

    @cached_property
    def ease(self) -> Float[Array, " nq"]:
        """How far each joint moves compared with others of the same effect, if their motion shall cost the least."""
        price = self.cost(self.start + _SHORT * np.eye(len(self.start))) / _SHORT
        least = float(price.min())
        if not least > 0.0:
            return np.ones(len(self.start))
        return np.maximum(np.square(least / price), _STIFFEST)

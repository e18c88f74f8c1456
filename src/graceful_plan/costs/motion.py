"""Motion costs: the cost of moving without failures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.exceptions import SettingError, ShapeError


@final
@dataclass(frozen=True)
class JointLength(Cost):
    """Euclidean length in joint space [rad], optionally with a weight per joint.

    Args:
        weights: Factor on each joint's motion, positive; None for equal weights of 1.
    """

    weights: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.weights is not None:
            object.__setattr__(self, "weights", tuple(float(w) for w in self.weights))
        if self.weights is not None and not all(np.isfinite(w) and w > 0 for w in self.weights):
            raise SettingError("weights", self.weights, "positive numbers, one per joint")

    def state(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the weighted length per unit of length: 1 without weights."""
        if self.weights is None:
            return np.ones(len(batch))
        if len(self.weights) != batch.q.shape[1]:
            raise ShapeError("JointLength.weights", (len(self.weights),), f"({batch.q.shape[1]},)")
        return np.linalg.norm(batch.direction * np.asarray(self.weights), axis=1)

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"]:
        """Return zero: the density does not depend on the configuration."""
        return np.zeros_like(batch.q)

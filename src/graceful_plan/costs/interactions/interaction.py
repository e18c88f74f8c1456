"""The interaction model contract: who is hit, given that the robot fails here and now."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.cost import StateBatch
from graceful_plan.kernels import ImpactKernel
from graceful_plan.scene import Scene

Array = np.ndarray


class InteractionModel(ABC):
    """Base of all interaction models: a frozen object with `probability`; `kernel` and `gradient` where it can."""

    @abstractmethod
    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P(component hits entity | failure) for each state, in the scene's order of components and entities.

        Laws: in [0, 1]; each state on its own; independent of severities.
        """

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component entity"]]:
        """Return `probability` by what goes wrong; the shares add up to it. A model need not tell sources apart."""
        return {"failure": self.probability(batch)}

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        """Return which faults are behind each of the `sources`, with their weights; a model need not know any."""
        return {}

    def kernel(
        self, scene: Scene, severity: Float[Array, "component entity"], paces: tuple[float, float]
    ) -> ImpactKernel | None:
        """Return the native kernel for sums of P S with these severities, None if there is none.

        Along an edge, samples are by turns at the two paces: shares of the velocity at which one joint is at its limit.

        Law: the same as from `probability`, to rounding.
        """
        del scene, severity, paces
        return None

    def gradient(self, batch: StateBatch, severity: Float[Array, "component entity"]) -> Float[Array, "n nq"] | None:
        """Return the derivative of sums of P S with respect to q at constant velocity, None if the model has none."""
        del batch, severity
        return None

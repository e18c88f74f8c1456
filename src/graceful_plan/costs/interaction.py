"""The interaction model contract: who is hit, given that the robot fails here and now."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.cost import Contract, StateBatch
from graceful_plan.scene.harm.fragility import FragilityTable

Array = np.ndarray


class InteractionModel(Contract):
    """Base of all interaction models: a frozen object with `probability`; `gradient` if it can, `sources` if it knows.

    One that knows what a failure does to the carried object itself has `knows_own_loss` and `own_loss`, too.

    Entities that move are left to `ImpactCost`.
    """

    @property
    def components(self) -> tuple[str, ...]:
        """Components that count in an `ImpactCost` unless it says otherwise."""
        return "carried", "contents"

    @abstractmethod
    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P(component hits entity | failure) for each state, in the scene's order of components and entities.

        Laws: in [0, 1]; each state on its own; independent of severities.
        """

    def gradient(self, batch: StateBatch, severity: Float[Array, "component entity"]) -> Float[Array, "n nq"] | None:
        """Return the derivative of sums of P S with respect to q at constant velocity, None if the model has none."""
        del batch, severity
        return None

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component entity"]]:
        """Return `probability` by what goes wrong; the shares add up to it. A model need not tell sources apart."""
        return {"failure": self.probability(batch)}

    @property
    def knows_own_loss(self) -> bool:
        """Whether there is something in `own_loss`."""
        return False

    def own_loss(self, batch: StateBatch, fragility: FragilityTable) -> Mapping[str, Float[Array, " n"]]:
        """Return P(the carried object itself is damaged | failure) for each state, by what goes wrong as in `sources`.

        Args:
            batch: The states, in a scene in which something is carried.
            fragility: How easily.
        """
        del batch, fragility
        return {}

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        """Return which faults are behind each of the `sources`, with their weights; a model need not know any."""
        return {}

"""The interaction model contract: the probability that each entity is hit, given a failure at a state."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import Contract, StateBatch
from graceful_plan.scene.harm.fragility import FragilityTable


class InteractionModel(Contract):
    """Base of all interaction models: a frozen object with `probability`, and optionally `gradient` and `sources`.

    A model that predicts damage to the carried object itself also has `knows_own_loss` and `own_loss`.

    `ImpactCost` handles moving entities separately.
    """

    @property
    def components(self) -> tuple[str, ...]:
        """Components that count in an `ImpactCost` by default."""
        return "carried", "contents"

    @abstractmethod
    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P(component hits entity | failure) for each state, in the scene's order of components and entities.

        Laws: in [0, 1]; each entry depends on its own state only; independent of severities.
        """

    def gradient(self, batch: StateBatch, severity: Float[Array, "component entity"]) -> Float[Array, "n nq"] | None:
        """Return the derivative of sums of P S with respect to q at constant velocity, None if the model has none."""
        del batch, severity
        return None

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component entity"]]:
        """Return `probability` by kind of failure; the shares add up to it. By default a single kind, "failure"."""
        return {"failure": self.probability(batch)}

    @property
    def knows_own_loss(self) -> bool:
        """Whether `own_loss` returns anything."""
        return False

    def own_loss(self, batch: StateBatch, fragility: FragilityTable) -> Mapping[str, Float[Array, " n"]]:
        """Return P(the carried object itself is damaged | failure) for each state, by kind of failure as in `sources`.

        Args:
            batch: The states, in a scene with a carried object.
            fragility: Table of fragilities.
        """
        del batch, fragility
        return {}

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        """Return the faults behind each of the `sources`, with their weights; empty if the model has no fault prior."""
        return {}

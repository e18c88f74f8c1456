"""The interaction model contract: who is hit, given that the robot fails here and now."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import FootprintSettings
from graceful_plan.costs.models.moving.footprint import MovingSettings, moving_probability
from graceful_plan.costs.models.moving.kernel import moving_kernels
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.scene import Scene

Array = np.ndarray


class InteractionModel(ABC):
    """Base of all interaction models: a frozen object with `probability`; `kernel` and `gradient` where it can."""

    @property
    def components(self) -> tuple[str, ...]:
        """Components that count in an `ImpactCost` unless it says otherwise."""
        return "carried", "contents"

    @abstractmethod
    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P(component hits entity | failure) for each state, in the scene's order of components and entities.

        Laws: in [0, 1]; each state on its own; independent of severities.
        """

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component entity"]]:
        """Return `probability` by what goes wrong; the shares add up to it. A model need not tell sources apart."""
        return {"failure": self.probability(batch)}

    def moving_settings(self) -> MovingSettings:
        """Return how to treat those who move; by default by the shipped drop model, every failure as both kinds."""
        return MovingSettings(constants=FootprintSettings.shipped())

    def moving_sources(
        self, batch: StateBatch, components: Collection[str] = COMPONENTS
    ) -> Mapping[str, Float[Array, "n component moving"]]:
        """Return P(component hits moving entity | failure) by what goes wrong, for `Scene.moving`.

        Unless a model knows better, the drop model (`moving_footprint.py`) with `moving_settings()`.

        Args:
            batch: States; without times, P is the mean over each entity's predicted path.
            components: Which to compute; the others may be 0.
        """
        settings = self.moving_settings()
        P = moving_probability(batch, settings.constants, components)
        falls = np.array([name != "body" for name in batch.scene.components])[:, None]
        return {"drop": settings.drop * P * falls, "collapse": settings.collapse * P * ~falls}

    def moving_kernels(
        self, scene: Scene, severity: Float[Array, "component moving"], paces: tuple[float, float]
    ) -> list[ImpactKernel] | None:
        """Return native kernels that together guide a search around moving entities, None if there are none.

        Law: close to sums of P S from `moving_sources` without times; they need not be the same.
        """
        falls = np.array([name != "body" for name in scene.components])
        own = type(self).moving_sources is not InteractionModel.moving_sources  # a model that computes otherwise
        if own or (severity[~falls] > 0.0).any():
            return None
        settings = self.moving_settings()
        return moving_kernels(scene, settings.constants, settings.drop * severity[falls].sum(axis=0), paces)

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

    def widened(self, metres: float) -> InteractionModel | None:
        """Return a model that smears hits by so much more, None if there is none; for descents from coarse to fine."""
        del metres
        return None

    def gradient(self, batch: StateBatch, severity: Float[Array, "component entity"]) -> Float[Array, "n nq"] | None:
        """Return the derivative of sums of P S with respect to q at constant velocity, None if the model has none."""
        del batch, severity
        return None

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"]
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return the derivatives with respect to q and to the joint velocities, None if the model has none."""
        del batch, severity
        return None

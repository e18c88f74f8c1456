"""What the interaction models of this library can do beyond their contract: run in the native core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@final
@dataclass(frozen=True)
class OwnLoss:
    """What the loss of the carried object itself counts, and how easily it is damaged."""

    severity: float
    fragility: FragilityTable


class NativeModel(InteractionModel):
    """Base of the models that the library brings; what one cannot do it answers with None."""

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        paces: tuple[float, float],
        own: OwnLoss | None = None,
    ) -> ImpactKernel | None:
        """Return the native kernel for sums of P S with these severities, None if there is none.

        With `own`, the loss of the carried object itself counts.

        Along an edge, samples are by turns at the two paces: shares of the velocity at which one joint is at its limit.

        Law: the same as from `probability` and `own_loss`, to rounding.
        """
        del scene, severity, paces, own
        return None

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"], own: OwnLoss | None = None
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return the derivatives of the same with respect to q and to the joint velocities, None if there are none."""
        del batch, severity, own
        return None

    def widened(self, metres: float) -> NativeModel | None:
        """Return a model that smears hits by so much more, None if there is none; for descents from coarse to fine."""
        del metres
        return None

    def moving(self) -> MovingModel:
        """Return the model for entities that move."""
        return MovingModel()


def moving_model(model: InteractionModel) -> MovingModel:
    """Return the model for entities that move; of a user's own model, every failure is both a drop and a collapse."""
    return model.moving() if isinstance(model, NativeModel) else MovingModel()

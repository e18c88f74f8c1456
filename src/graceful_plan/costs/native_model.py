"""Base of the interaction models of this library, which run in the native core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.scene import Scene


@final
@dataclass(frozen=True)
class OwnLoss:
    """Severity of the loss of the carried object itself, and the table of fragilities."""

    severity: float
    fragility: FragilityTable


class NativeModel(InteractionModel):
    """Base of the library's models; unsupported methods return None."""

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        paces: tuple[float, float],
        own: OwnLoss | None = None,
    ) -> ImpactKernel | None:
        """Return the native kernel for sums of P S with these severities, None if there is none.

        With `own`, the loss of the carried object itself counts.

        Samples along an edge alternate between the two paces: fractions of the speed at which one joint is at its
        velocity limit.

        Law: equal to the sums from `probability` and `own_loss`, up to rounding.
        """
        del scene, severity, paces, own
        return None

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"], own: OwnLoss | None = None
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return the derivatives of that sum with respect to q and to the joint velocities, None if unsupported."""
        del batch, severity, own
        return None

    def widened(self, metres: float) -> NativeModel | None:
        """Return a model with hits blurred by a standard deviation [m], None if unsupported; for descents."""
        del metres
        return None

    def moving(self) -> MovingModel:
        """Return the model for moving entities."""
        return MovingModel()


def moving_model(model: InteractionModel) -> MovingModel:
    """Return the model for moving entities; for a user's model, every failure is both a drop and a collapse."""
    return model.moving() if isinstance(model, NativeModel) else MovingModel()

"""The contract of models of failing bases; interaction models mix them with failures of gripper and arm."""

from __future__ import annotations

from abc import ABC, abstractmethod

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.scene.mobile.optional import import_mobile
from graceful_plan.scene.scene import Scene


class FailingBase(ABC):
    """Model of a failing mobile base and the entities that it hits. Frozen and hashable."""

    @abstractmethod
    def of_base(self, scene: Scene) -> float:
        """Return P that the base fails, given a failure of the scene's robot."""

    @abstractmethod
    def of_cargo(self, scene: Scene) -> float:
        """Return P that gripper or arm fails, or that a base without an arm throws off its cargo."""

    @abstractmethod
    def worth(self, speed: float) -> float:
        """Return the factor of the severity for a hit by the base at a speed [m/s]."""

    @abstractmethod
    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P(the base hits entity | it fails), times the factor `worth`."""

    def hits_with(self, scene: Scene) -> tuple[str, ...]:
        """Return the components that hit the entities which the base hits; by default the body alone."""
        del scene
        return ("body",)

    @abstractmethod
    def meeting(self, scene: Scene) -> _native.MovingSource:
        """Return the native model of hits on moving entities."""

    def roughly(self) -> FailingBase:
        """Return a faster approximation of this model, for descents and searches; by default the model itself."""
        return self

    @abstractmethod
    def kernel(
        self, scene: Scene, severity: Float[Array, "component entity"], paces: tuple[float, float]
    ) -> ImpactKernel:
        """Return the native kernel for sums of P S; see `NativeModel.kernel`."""

    @abstractmethod
    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"]
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return the derivatives of sums of P S with respect to q and to the joint velocities."""


def failing_base(scene: Scene, chosen: FailingBase | None = None) -> FailingBase | None:
    """Return the model of the failing base of a scene's robot; None for a robot without a base.

    Args:
        scene: The scene.
        chosen: The model to use; by default the shipped one.

    Raises:
        UnsupportedError: If there is a base, but the package with the shipped model is not installed.
    """
    if scene.base is None or chosen is not None:
        return chosen if scene.base is not None else None
    shipped: FailingBase = import_mobile("coast.coast").Coast()
    return shipped

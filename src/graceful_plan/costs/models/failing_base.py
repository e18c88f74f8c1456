"""The contract of a model of failing bases, which interaction models mix with those of gripper and arm."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.scene.mobile.room import mobile_room
from graceful_plan.scene.scene import Scene

Array = np.ndarray


class FailingBase(ABC):
    """How bases that drive fail, and what they then hit. Frozen and hashable."""

    @property
    @abstractmethod
    def share(self) -> float:
        """P that it is the base that fails, given a failure of a robot that has an arm besides."""

    @abstractmethod
    def of_base(self, scene: Scene) -> float:
        """Return P that it is the base that fails, given a failure of a scene's robot."""

    @abstractmethod
    def of_cargo(self, scene: Scene) -> float:
        """Return P that it is gripper or arm, or that a base without an arm throws off what stands on it."""

    @abstractmethod
    def worth(self, speed: float) -> float:
        """Return the share of a severity that a hit by the base at a speed [m/s] is worth."""

    @abstractmethod
    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P(the base hits entity | it fails), times what the hit is worth; zero but for the body."""

    @abstractmethod
    def meeting(self, scene: Scene) -> _native.MovingSource:
        """Return the same in the core, for entities that move."""

    def roughly(self) -> FailingBase:
        """Return a model that is close and faster, for descents and searches; by default the same."""
        return self

    @abstractmethod
    def kernel(
        self, scene: Scene, severity: Float[Array, "component entity"], paces: tuple[float, float]
    ) -> ImpactKernel:
        """Return the native kernel for sums of P S: see `NativeModel.kernel`."""

    @abstractmethod
    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"]
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return its derivatives with respect to q and to the joint velocities."""


def failing_base(scene: Scene, chosen: FailingBase | None = None) -> FailingBase | None:
    """Return how the base of a scene's robot fails; None for a robot without one.

    Args:
        scene: Where.
        chosen: The model to use; by default the shipped one.

    Raises:
        UnsupportedError: If there is a base, and the room that has the shipped model is not installed.
    """
    if scene.base is None or chosen is not None:
        return chosen if scene.base is not None else None
    shipped: FailingBase = mobile_room("coast.coast").Coast()
    return shipped

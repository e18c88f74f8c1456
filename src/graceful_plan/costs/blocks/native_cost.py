"""Base of the composable costs: they run in the core, alone and in sums."""

from __future__ import annotations

from abc import abstractmethod
from functools import reduce
from operator import add

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import Cost, StateBatch, SumCost
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

_MOST_KERNELS = 32
"""Number of kernels kept for a scene, so that trying many settings does not exhaust memory."""


class NativeCost(Cost):
    """Base of costs that run in the core and depend on the configuration alone, not on the velocity."""

    @abstractmethod
    def kernel(self, scene: Scene) -> ImpactKernel:
        """Return the native kernel of this cost in a scene."""

    def state(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the cost density at each state."""
        return _kernel(batch.scene, self).states(batch.q)

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"]:
        """Return the derivative of `state` with respect to q."""
        return _kernel(batch.scene, self).state_slopes(batch.q, np.zeros_like(batch.q))[1]


@per_scene(most=_MOST_KERNELS)
def _kernel(scene: Scene, cost: NativeCost) -> ImpactKernel:
    return cost.kernel(scene)


@per_scene(most=_MOST_KERNELS)
def _impact_kernel(scene: Scene, cost: ImpactCost, paces: tuple[float, float]) -> ImpactKernel | None:
    """Return a cached kernel of a cost given by model names, since every call of `plan` uses the same one or two."""
    return cost.kernel(scene, paces)


def native_kernel(cost: Cost, scene: Scene, paces: tuple[float, float]) -> ImpactKernel | None:
    """Return the native kernel of a cost, None if the cost has to run in Python.

    Args:
        cost: A cost of this library, or a sum of such.
        scene: The scene.
        paces: See `NativeModel.kernel`.
    """
    if isinstance(cost, ImpactCost):
        named = isinstance(cost.model, str) and isinstance(cost.consequence, str)
        return _impact_kernel(scene, cost, paces) if named else cost.kernel(scene, paces)
    if isinstance(cost, NativeCost):
        return _kernel(scene, cost)
    if not isinstance(cost, SumCost):
        return None
    kernels = [(factor, native_kernel(term, scene, paces)) for factor, term in cost.terms]
    scaled = [kernel.scaled(factor) for factor, kernel in kernels if kernel is not None]
    return reduce(add, scaled) if len(scaled) == len(kernels) else None

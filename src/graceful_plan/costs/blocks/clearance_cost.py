"""How near a robot comes to what stands around it, to itself, or to somebody."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.blocks.native_cost import NativeCost
from graceful_plan.costs.one_thing import SURROUNDINGS, kernels_of_one_thing
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.scene import Scene


@final
@dataclass(frozen=True)
class ClearanceCost(NativeCost):
    r"""Charges for every state that is nearer to something than wanted.

    .. math:: \max(0, 1 - d / D)

    with d the signed clearance of the spheres that cover robot and carried object, and D the distance: 0 from there on,
    1 at contact. It looks at what stands still; where entities move to is not known of a state.

    Args:
        distance: Clearance from which on nothing is charged [m], > 0.
        to: What clearance is of: "surroundings" for all that is not the robot; "self" for links, and the carried
            object, among themselves; or the name of an entity.

    Raises:
        SettingError: If the distance is not a finite number > 0.
    """

    distance: float = 0.05
    to: str = SURROUNDINGS

    def __post_init__(self) -> None:
        if not 0.0 < self.distance < np.inf:
            raise SettingError("distance", self.distance, "a finite number > 0 [m]")

    def kernel(self, scene: Scene) -> ImpactKernel:
        """Make what computes the cost in a scene.

        Raises:
            UnknownNameError: If there is no such entity in the scene.
        """
        kernels = compile_scene(scene).kernels
        seen = kernels_of_one_thing(scene, self.to)
        return ImpactKernel(kernels, _native.ClearanceCost(kernels.core, seen.core, self.distance))

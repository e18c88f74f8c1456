"""Cost of low clearance to the surroundings, to the robot itself or to one entity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.blocks.native_cost import NativeCost
from graceful_plan.costs.clearance_target import SURROUNDINGS, kernels_for_target
from graceful_plan.path import plain_numbers
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive


@final
@dataclass(frozen=True)
class ClearanceCost(NativeCost):
    r"""Penalises states whose clearance is below a desired distance.

    .. math:: \max(0, 1 - d / D)

    with d the signed clearance of the spheres that cover robot and carried object, and D the distance: the cost is 1 at
    contact and 0 from D on. Only static obstacles and entities count, since a state does not hold the time.

    Args:
        distance: Clearance from which on the cost is 0 [m], > 0.
        to: Reference of the clearance: "surroundings" for everything except the robot; "self" for links, and the
            carried object, among themselves; or the name of an entity.

    Raises:
        SettingError: If the distance is not a finite number > 0.
    """

    distance: float = 0.05
    to: str = SURROUNDINGS

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive("distance", self.distance, "a finite number > 0 [m]")

    def kernel(self, scene: Scene) -> ImpactKernel:
        """Return the native kernel of this cost in a scene.

        Raises:
            UnknownNameError: If there is no such entity in the scene.
        """
        kernels = compile_scene(scene).kernels
        seen = kernels_for_target(scene, self.to)
        return ImpactKernel(kernels, _native.ClearanceCost(kernels.core, seen.core, self.distance))

"""How near a robot comes to what stands around it, to itself, or to somebody."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from graceful_plan.array_types import Int
from graceful_plan.core import _native
from graceful_plan.core.arrays import WorldArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel, Kernels
from graceful_plan.costs.blocks.native_cost import NativeCost
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

Array = np.ndarray

SURROUNDINGS, SELF = "surroundings", "self"


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
        return ImpactKernel(kernels, _native.ClearanceCost(kernels.core, _seeing(scene, self.to).core, self.distance))


@per_scene
def _seeing(scene: Scene, to: str) -> Kernels:
    """Return kernels that see nothing but one thing to hit."""
    if to not in (SURROUNDINGS, SELF) and to not in scene.entities:
        raise UnknownNameError("thing to keep clear of", to, [SURROUNDINGS, SELF, *scene.entities])
    compiled = compile_scene(scene)
    robot, world = compiled.robot, compiled.world
    if to == SELF:
        return Kernels(robot, _some(world, np.zeros(0, dtype=int)), compiled.hazards)
    if to != SURROUNDINGS:
        world = _some(world, np.flatnonzero(np.isin(world.geom, scene.entities[to].geoms)))
    return Kernels(
        replace(robot, self_pair=robot.self_pair[:0], self_slack=robot.self_slack[:0]), world, compiled.hazards
    )


def _some(world: WorldArrays, rows: Int[Array, " row"]) -> WorldArrays:
    """Keep some of the obstacles."""
    starts, ends = world.hull_start[:-1][rows], world.hull_start[1:][rows]
    triangles = [world.triangles[first:end] for first, end in zip(starts, ends, strict=True)]
    return WorldArrays(
        kind=world.kind[rows],
        pose=world.pose[rows],
        size=world.size[rows],
        bound=world.bound[rows],
        ignores=world.ignores[rows],
        hull_start=np.append(0, np.cumsum(ends - starts)),
        triangles=np.concatenate([world.triangles[:0], *triangles]),
        geom=world.geom[rows],
    )

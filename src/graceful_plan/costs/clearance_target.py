"""Collision kernels restricted to one target: the surroundings, the robot itself, or one entity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Array, Int
from graceful_plan.core.arrays import WorldArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

SURROUNDINGS, SELF = "surroundings", "self"


@per_scene
def kernels_for_target(scene: Scene, to: str) -> Kernels:
    """Return collision kernels that ignore everything but one target.

    Args:
        scene: The scene.
        to: "surroundings", "self", or the name of an entity.

    Raises:
        UnknownNameError: If there is no such entity in the scene.
    """
    if to not in (SURROUNDINGS, SELF) and to not in scene.entities:
        raise UnknownNameError("clearance target", to, [SURROUNDINGS, SELF, *scene.entities])
    compiled = compile_scene(scene)
    robot, world = compiled.robot, compiled.world
    if to == SELF:
        return Kernels(robot, _some(world, np.zeros(0, dtype=int)), compiled.impact_tables)
    if to != SURROUNDINGS:
        world = _some(world, np.flatnonzero(np.isin(world.geom, scene.entities[to].geoms)))
    return Kernels(
        replace(robot, self_pair=robot.self_pair[:0], self_slack=robot.self_slack[:0]), world, compiled.impact_tables
    )


def _some(world: WorldArrays, rows: Int[Array, " row"]) -> WorldArrays:
    """Return the given obstacles only."""
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

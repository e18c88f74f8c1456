"""Constraint that keeps a distance from an entity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.core.arrays import WorldArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.rules.rules import DistanceRule
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive

_FAR = 1e3
"""Distance to report where nothing is near [m]."""


@final
@dataclass(frozen=True)
class KeepDistance(Constraint):
    """Keep robot and carried object at a distance from an entity.

    Args:
        entity: Name of a static entity.
        metres: Least distance [m], above 0.
    """

    entity: str
    metres: float

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive("metres", self.metres, "a finite distance above 0 m")

    def rule(self, scene: Scene) -> DistanceRule:
        """Return the rule for a scene; raise if the scene has no such entity."""
        if self.entity not in scene.entities:
            raise UnknownNameError("entity", self.entity, scene.entities)
        return DistanceRule(name=self.name, entity=self.entity, metres=self.metres)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the least distance minus the actual one [m], measured with the robot's collision spheres."""
        return np.maximum(self.metres - distance_kernels(batch.scene, self.entity).clearance(batch.q), -_FAR)

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        return f"{self.name}: {1e3 * residual:.3g} mm nearer to {self.entity!r} than the {self.metres:g} m to be kept"


@per_scene
def distance_kernels(scene: Scene, entity: str) -> Kernels:
    """Return kernels whose only obstacle is the entity, so that their clearance is the distance from it."""
    compiled = compile_scene(scene)
    world = compiled.world
    mine = np.isin(world.geom, list(scene.entities[entity].geoms))
    first, count = world.hull_start[:-1][mine], np.diff(world.hull_start)[mine]
    triangles = [world.triangles[a : a + n] for a, n in zip(first, count, strict=True)]
    only = WorldArrays(
        kind=world.kind[mine],
        pose=world.pose[mine],
        size=world.size[mine],
        bound=world.bound[mine],
        ignores=np.zeros_like(world.ignores[mine]),
        hull_start=np.concatenate([[0], np.cumsum(count)]).astype(world.hull_start.dtype),
        triangles=np.concatenate([np.zeros((0, 3, 3)), *triangles]),
        geom=world.geom[mine],
    )
    robot = replace(compiled.robot, self_pair=compiled.robot.self_pair[:0], self_slack=np.zeros(0))
    return Kernels(robot, only, compiled.impact_tables)

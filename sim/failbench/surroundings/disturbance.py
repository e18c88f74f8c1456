"""Base class of faults of the surroundings: the robot is healthy, and the scene around it changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.fault import SURROUNDINGS, Fault
from failbench.simulated.moving_entities import EntityPoses
from failbench.simulated.simulation import Simulation
from failbench.simulated.world import World
from graceful_plan import MovingEntity, Scene
from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError

PARKED = (60.0, 60.0, -30.0)
"""Parking position of visitors that have not appeared yet: far away and below the floor, in W [m]."""


@dataclass(frozen=True, kw_only=True)
class Disturbance(Fault):
    """An event around a robot. Onset, degree, ramp and duration are those of any fault.

    To add one, write a frozen dataclass as for any `Fault` that changes `plant.walk`, `plant.xfrc` or model fields.
    Its `visitor` returns the entity it needs in the scene. `targets` must be empty.
    """

    CATEGORY: ClassVar[str] = SURROUNDINGS
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.targets:
            raise SettingError("targets", self.targets, f"none: {self.NAME} strikes no part of the robot")

    def visitor(self) -> MovingEntity | None:
        """Return the entity that must be in the scene, parked, before the event; None if there is none."""
        return None


def scene_with_intruder(fault: Fault, scene: Scene) -> Scene:
    """Return a scene in which a fault can happen: with its visitor, if any, parked away from the robot."""
    visitor = fault.visitor() if isinstance(fault, Disturbance) else None
    return scene if visitor is None or visitor.name in scene.moving else scene.with_moving(visitor)


def world_of(plant: Simulation) -> World:
    """Return the world of a plant."""
    if plant.world is None:
        raise UnsupportedError("faults of the surroundings need a world; this plant has none")
    return plant.world


def movable(plant: Simulation, entity: str) -> int:
    """Return the body of a movable entity, or a random one for "any".

    Raises:
        UnknownNameError: If there is no movable entity of this name.
        UnsupportedError: If the scene has no movable entity.
    """
    bodies = world_of(plant).movable
    if not bodies:
        raise UnsupportedError("no entity of the scene can move")
    drawn = list(bodies)[int(plant.rng.integers(len(bodies)))]
    if entity != "any" and entity not in bodies:
        raise UnknownNameError("entity that can move", entity, bodies)
    return bodies[drawn if entity == "any" else entity]


def tool_at(plant: Simulation, time: Array) -> Array:
    """Return the planned tool positions at times since the onset [s], in W [m]."""
    scene = world_of(plant).scene
    site = int(scene.model.site(scene.tool).id)
    return np.array([scene.data_at(q).site_xpos[site].copy() for q in plant.planned(time)])


def go(plant: Simulation, name: str, position: Array, yaw: Array) -> None:
    """Set position and yaw of a moving entity before each further step and after the last."""
    world = world_of(plant)
    names = [walker.name for walker in world.walkers]
    if name not in names:
        raise UnsupportedError(f"{name!r} is not in the scene; use failbench.scene_with_intruder(fault, scene)")
    walk = EntityPoses(world.model, world.walkers)
    walk.write(plant.walk[plant.step :], names.index(name), position, yaw)

"""The contract of a fault of the surroundings: the robot is sound, and what is around it changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.fault import SURROUNDINGS, Fault
from failbench.simulated.plant import Plant
from failbench.simulated.walkers import Walk
from failbench.simulated.world import World
from graceful_plan import MovingEntity, Scene
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError

Array = np.ndarray

PARKED = (60.0, 60.0, -30.0)
"""Where somebody or something waits that has not come yet: far away and below the floor [m]."""


@dataclass(frozen=True, kw_only=True)
class Disturbance(Fault):
    """Something that happens around a robot. Onset, degree, ramp and duration are those of any fault.

    One of your own is a frozen dataclass like that of any `Fault`, which acts on `plant.walk`, `plant.xfrc` or model
    fields; `visitor` says whom it needs in the scene. `targets` mean nothing here.
    """

    CATEGORY: ClassVar[str] = SURROUNDINGS
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.targets:
            raise SettingError("targets", self.targets, f"none: a {self.NAME} strikes no part of the robot")

    def visitor(self) -> MovingEntity | None:
        """Return who or what has to be in the scene, out of the way, until this happens; None if nobody."""
        return None


def staged_for(fault: Fault, scene: Scene) -> Scene:
    """Return a scene in which a fault can happen: with whom it needs, who is still out of the way."""
    visitor = fault.visitor() if isinstance(fault, Disturbance) else None
    return scene if visitor is None or visitor.name in scene.moving else scene.with_moving(visitor)


def world_of(plant: Plant) -> World:
    """Return where a plant is."""
    if plant.world is None:
        raise UnsupportedError("surroundings fail where there are some; this robot is alone")
    return plant.world


def movable(plant: Plant, entity: str) -> int:
    """Return the body of an entity that can move, or of one drawn at random.

    Raises:
        UnknownNameError: If there is no such entity.
        UnsupportedError: If nothing can move.
    """
    bodies = world_of(plant).movable
    if not bodies:
        raise UnsupportedError("no entity of the scene can move")
    drawn = list(bodies)[int(plant.rng.integers(len(bodies)))]
    if entity != "any" and entity not in bodies:
        raise UnknownNameError("entity that can move", entity, bodies)
    return bodies[drawn if entity == "any" else entity]


def tool_at(plant: Plant, time: Array) -> Array:
    """Return where the tool is to be at times since the onset [s], in W [m]."""
    scene = world_of(plant).scene
    site = int(scene.model.site(scene.tool).id)
    return np.array([scene.data_at(q).site_xpos[site].copy() for q in plant.planned(time)])


def go(plant: Plant, name: str, position: Array, yaw: Array) -> None:
    """Let one who moves be at these places and turned so before each step from now on and after the last."""
    world = world_of(plant)
    names = [walker.name for walker in world.walkers]
    if name not in names:
        raise UnsupportedError(f"{name!r} is not in the scene; stage it with failbench.staged_for(fault, scene)")
    walk = Walk(world.model, world.walkers)
    walk.write(plant.walk[plant.step :], names.index(name), position, yaw)

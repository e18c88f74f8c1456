"""Faults of objects: pushed, added, bumped, slippery, heavy. Values and their reasons: docs/surroundings.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.basics.onset import AtFraction, Onset
from failbench.fault.drives import GRIP, cut_overloaded_weld
from failbench.simulated.simulation import Simulation
from failbench.surroundings.disturbance import PARKED, Disturbance, go, movable, tool_at, world_of
from graceful_plan import MovingEntity
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.setting_checks import positive

PUSH = 0.05
"""Duration of a push, and of half a bump [s]."""
_CLEAR = 0.1
"""Least distance of an added object from the tool at the onset, plus half its diagonal [m]."""
_FIRST = AtFraction(0.0)
_AHEAD, _LOOK = 5.0, 0.05
"""Length of the planned motion searched for the place of an added object, and sampling interval [s]."""
_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0")
"""Fields that MuJoCo derives from masses and scales constraints with."""


def _direction(plant: Simulation) -> np.ndarray:
    """Return a random horizontal direction, drawn once per rollout."""
    if "heading" not in plant.memory:
        plant.memory["heading"] = plant.rng.uniform(-math.pi, math.pi)
    heading = plant.memory["heading"]
    return np.array([math.cos(heading), math.sin(heading), 0.0])


@dataclass(frozen=True, kw_only=True)
class PushedObject(Disturbance):
    """An object is pushed horizontally in a random direction.

    Args:
        entity: Name of the pushed entity, or "any" for a random one.
    """

    entity: str = "any"

    NAME: ClassVar[str] = "pushed_object"
    PARAMETER: ClassVar[str] = "speed of the object after the push without friction [m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.5, "moderate": 1.0, "severe": 2.0, "critical": 4.0}
    PERIOD: ClassVar[float | None] = PUSH

    def apply(self, plant: Simulation, level: float) -> None:
        """Push the object through its centre of mass for the time `PUSH`."""
        body = plant.memory.get("body")
        if body is None:
            body = plant.memory["body"] = movable(plant, self.entity)
        direction = _direction(plant)
        if plant.time < PUSH - plant.dt / 2.0:
            mass = float(world_of(plant).model.body_mass[body])
            plant.xfrc[body, :3] = mass * level * self.amount / PUSH * direction


@dataclass(frozen=True, kw_only=True)
class BumpedTable(Disturbance):
    """The table is bumped: it jumps aside and stops.

    In the table's frame, all movable entities are pushed the opposite way, then back, including those that stand
    elsewhere. The robot is not affected.
    """

    NAME: ClassVar[str] = "bumped_table"
    PARAMETER: ClassVar[str] = "greatest speed of the table [m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.3, "moderate": 0.6, "severe": 1.2, "critical": 2.4}
    PERIOD: ClassVar[float | None] = PUSH

    def apply(self, plant: Simulation, level: float) -> None:
        """Apply the inertial forces of the table's acceleration, then of its deceleration."""
        world, direction = world_of(plant), _direction(plant)
        if not world.movable:
            raise UnsupportedError("no entity of the scene can move")
        if plant.time < 2.0 * PUSH - plant.dt / 2.0:
            sign = -1.0 if plant.time < PUSH - plant.dt / 2.0 else 1.0
            for body in world.movable.values():
                force = float(world.model.body_mass[body]) * level * self.amount / PUSH
                plant.xfrc[body, :3] = sign * force * direction


@dataclass(frozen=True, kw_only=True)
class WetFloor(Disturbance):
    """Everything but the robot gets slippery, and the carried object in contacts other than with the fingers."""

    NAME: ClassVar[str] = "wet_floor"
    PARAMETER: ClassVar[str] = "remaining friction, as a fraction of the dry one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.6, "moderate": 0.4, "severe": 0.2, "critical": 0.05}
    FIELDS: ClassVar[tuple[str, ...]] = ("geom_friction",)

    def apply(self, plant: Simulation, level: float) -> None:
        """Scale the friction of all geoms outside the robot. Contacts of the fingers keep theirs by priority."""
        world = world_of(plant)
        robot = np.isin(world.model.geom_bodyid, sorted(world.scene.robot_bodies))
        plant["geom_friction"][~robot] *= 1.0 + level * (self.amount - 1.0)


@dataclass(frozen=True, kw_only=True)
class HeavierObject(Disturbance):
    """The carried object is heavier than assumed; the controller compensates the assumed weight.

    By default it is heavier from the beginning of the motion.
    """

    when: Onset = _FIRST

    NAME: ClassVar[str] = "heavier_object"
    PARAMETER: ClassVar[str] = "mass, as a multiple of the assumed one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 1.5, "moderate": 2.0, "severe": 4.0, "critical": 8.0}
    FIELDS: ClassVar[tuple[str, ...]] = ("body_inertia", *_DERIVED, "actuator_forcerange", *GRIP)

    def apply(self, plant: Simulation, level: float) -> None:
        """Scale mass and inertia, and cut the weld if fingers could not hold the weight."""
        carried = world_of(plant).carried_body
        if carried < 0:
            raise UnsupportedError("the scene has no carried object to make heavier")
        factor = 1.0 + level * (self.amount - 1.0)
        dofs = world_of(plant).model.dof_bodyid == carried
        for name in ("body_mass", "body_inertia", "body_subtreemass"):
            plant[name][carried] *= factor
        plant["body_invweight0"][carried] /= factor
        plant["dof_invweight0"][dofs] /= factor
        cut_overloaded_weld(plant)


@dataclass(frozen=True, kw_only=True)
class AddedObject(Disturbance):
    """An object is put into the tool's future path. It does not move when hit.

    Args:
        category: Entity class in the severity table.
        size: Half of each side [m].
    """

    category: str = "robust"
    size: float = 0.04

    NAME: ClassVar[str] = "added_object"
    PARAMETER: ClassVar[str] = "fraction of the remaining path at which the object stands"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.6, "severe": 0.4, "critical": 0.2}

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("size", self.size, "a finite length above 0 m")

    def visitor(self) -> MovingEntity:
        """Return the object, parked away from the scene."""
        return MovingEntity(self.NAME, self.category, size=[self.size] * 3, t=[0.0], position=[PARKED])

    def apply(self, plant: Simulation, level: float) -> None:
        """Put the object into the path; leave it parked if the tool does not move far enough any more."""
        del level  # the object is there or not
        if "place" not in plant.memory:
            plant.memory["place"] = self._place(plant)
        rows = len(plant.walk) - plant.step
        go(plant, self.NAME, np.tile(plant.memory["place"], (rows, 1)), np.zeros(rows))

    def _place(self, plant: Simulation) -> np.ndarray:
        tools = tool_at(plant, np.arange(0.0, _AHEAD, _LOOK))
        gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tools, axis=0), axis=1)))
        clear = np.linalg.norm(tools - tools[0], axis=1) >= _CLEAR + self.size * math.sqrt(3.0)
        found = np.flatnonzero(clear & (gone >= self.amount * gone[-1]))
        return tools[found[0]] if len(found) else np.array(PARKED)

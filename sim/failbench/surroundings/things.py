"""Faults of things: pushed, added, bumped, slippery, heavy. Values and their reasons: docs/surroundings.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.basics.onset import AtFraction, Onset
from failbench.fault.drives import GRIP, cut_overloaded_weld
from failbench.simulated.plant import Plant
from failbench.surroundings.disturbance import PARKED, Disturbance, go, movable, tool_at, world_of
from graceful_plan import MovingEntity
from graceful_plan.exceptions import SettingError, UnsupportedError

PUSH = 0.05
"""How long a push takes, and half of a bump [s]."""
_CLEAR = 0.1
"""What is put in the way is at least so far from the tool then [m], besides its own size."""
_FIRST = AtFraction(0.0)
_AHEAD, _LOOK = 5.0, 0.05
"""How far ahead of the motion it is looked for a place, and how often [s]."""
_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0")
"""What MuJoCo derives from masses, and constraints are scaled with."""


def _direction(plant: Plant) -> np.ndarray:
    """Return a horizontal direction, drawn once."""
    if "heading" not in plant.memory:
        plant.memory["heading"] = plant.rng.uniform(-math.pi, math.pi)
    heading = plant.memory["heading"]
    return np.array([math.cos(heading), math.sin(heading), 0.0])


@dataclass(frozen=True, kw_only=True)
class PushedObject(Disturbance):
    """Somebody pushes a thing, horizontally in a direction that the seed has.

    Args:
        entity: Name of what is pushed, or "any" for one drawn at random.
    """

    entity: str = "any"

    NAME: ClassVar[str] = "pushed_object"
    PARAMETER: ClassVar[str] = "speed that the push would give it without friction [m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.5, "moderate": 1.0, "severe": 2.0, "critical": 4.0}
    PERIOD: ClassVar[float | None] = PUSH

    def apply(self, plant: Plant, level: float) -> None:
        """Push it through its centre of mass, for a moment."""
        body = plant.memory.get("body")
        if body is None:
            body = plant.memory["body"] = movable(plant, self.entity)
        direction = _direction(plant)
        if plant.time < PUSH - plant.dt / 2.0:
            mass = float(world_of(plant).model.body_mass[body])
            plant.xfrc[body, :3] = mass * level * self.amount / PUSH * direction


@dataclass(frozen=True, kw_only=True)
class BumpedTable(Disturbance):
    """Somebody runs into the table: it jumps aside and stops.

    Seen from the table, all that can move on it, or stands elsewhere, is pushed the other way, then back. The robot
    stands on its own feet.
    """

    NAME: ClassVar[str] = "bumped_table"
    PARAMETER: ClassVar[str] = "greatest speed of the table [m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.3, "moderate": 0.6, "severe": 1.2, "critical": 2.4}
    PERIOD: ClassVar[float | None] = PUSH

    def apply(self, plant: Plant, level: float) -> None:
        """Let things feel how the table sets off, and how it stops."""
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
    """Everything but the robot gets slippery, the carried object too where it touches anything but the fingers."""

    NAME: ClassVar[str] = "wet_floor"
    PARAMETER: ClassVar[str] = "friction that is left, as a share of the dry one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.6, "moderate": 0.4, "severe": 0.2, "critical": 0.05}
    FIELDS: ClassVar[tuple[str, ...]] = ("geom_friction",)

    def apply(self, plant: Plant, level: float) -> None:
        """Scale the friction of whatever is no part of the robot; fingers have their own say."""
        world = world_of(plant)
        robot = np.isin(world.model.geom_bodyid, sorted(world.scene.robot_bodies))
        plant["geom_friction"][~robot] *= 1.0 + level * (self.amount - 1.0)


@dataclass(frozen=True, kw_only=True)
class HeavierObject(Disturbance):
    """The carried object is heavier than thought: the controller makes up for the weight that it was told.

    It is from the beginning unless `when` says otherwise.
    """

    when: Onset = _FIRST

    NAME: ClassVar[str] = "heavier_object"
    PARAMETER: ClassVar[str] = "mass, as a multiple of what was thought"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 1.5, "moderate": 2.0, "severe": 4.0, "critical": 8.0}
    FIELDS: ClassVar[tuple[str, ...]] = ("body_inertia", *_DERIVED, "actuator_forcerange", *GRIP)

    def apply(self, plant: Plant, level: float) -> None:
        """Scale mass and inertia; a weld breaks where fingers would not hold the weight."""
        carried = world_of(plant).carried_body
        if carried < 0:
            raise UnsupportedError("nothing is carried that could be heavy")
        factor = 1.0 + level * (self.amount - 1.0)
        dofs = world_of(plant).model.dof_bodyid == carried
        for name in ("body_mass", "body_inertia", "body_subtreemass"):
            plant[name][carried] *= factor
        plant["body_invweight0"][carried] /= factor
        plant["dof_invweight0"][dofs] /= factor
        cut_overloaded_weld(plant)


@dataclass(frozen=True, kw_only=True)
class AddedObject(Disturbance):
    """Somebody puts a thing where the tool is going to be. It stands fast, whatever runs into it.

    Args:
        category: Its class in the severity table.
        size: Half of each side [m].
    """

    category: str = "robust"
    size: float = 0.04

    NAME: ClassVar[str] = "added_object"
    PARAMETER: ClassVar[str] = "part of the motion that is left until it is met"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.6, "severe": 0.4, "critical": 0.2}

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.size) and self.size > 0.0):
            raise SettingError("size", self.size, "a finite length above 0 m")

    def visitor(self) -> MovingEntity:
        """Return it, still elsewhere."""
        return MovingEntity(self.NAME, self.category, size=[self.size] * 3, t=[0.0], position=[PARKED])

    def apply(self, plant: Plant, level: float) -> None:
        """Put it there; if the tool does not come far any more, in no place."""
        del level  # it is there or it is not
        if "place" not in plant.memory:
            plant.memory["place"] = self._place(plant)
        rows = len(plant.walk) - plant.step
        go(plant, self.NAME, np.tile(plant.memory["place"], (rows, 1)), np.zeros(rows))

    def _place(self, plant: Plant) -> np.ndarray:
        tools = tool_at(plant, np.arange(0.0, _AHEAD, _LOOK))
        gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tools, axis=0), axis=1)))
        clear = np.linalg.norm(tools - tools[0], axis=1) >= _CLEAR + self.size * math.sqrt(3.0)
        found = np.flatnonzero(clear & (gone >= self.amount * gone[-1]))
        return tools[found[0]] if len(found) else np.array(PARKED)

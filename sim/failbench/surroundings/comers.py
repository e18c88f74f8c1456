"""Intruders: a person walks in, a door opens. Values and their reasons: docs/surroundings.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.simulated.simulation import Simulation
from failbench.surroundings.disturbance import PARKED, Disturbance, go, tool_at
from graceful_plan import MovingEntity
from graceful_plan.exceptions import SettingError
from graceful_plan.setting_checks import not_negative, positive

_HALF_TURN = math.pi / 2.0


@dataclass(frozen=True, kw_only=True)
class PersonWalksIn(Disturbance):
    """An unpredicted person walks along a straight line past the tool's position at the onset.

    Args:
        category: Entity class in the severity table.
        distance: Distance from the passing point at the onset [m].
        passing: Greatest lateral distance between the line and the tool, on a random side [m].
        radius: Radius of the body, an upright cylinder [m].
        height: Height of the body [m].
    """

    category: str = "adult"
    distance: float = 1.2
    passing: float = 0.4
    radius: float = 0.2
    height: float = 1.7

    NAME: ClassVar[str] = "person_walks_in"
    PARAMETER: ClassVar[str] = "walking speed [m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.5, "moderate": 1.0, "severe": 1.5, "critical": 2.5}

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("distance", "radius", "height"):
            value = getattr(self, name)
            positive(name, value, "a finite length above 0 m")
        not_negative("passing", self.passing, "a finite length of at least 0 m")

    def visitor(self) -> MovingEntity:
        """Return the person, parked away from the scene."""
        size = [self.radius, self.height / 2.0]
        return MovingEntity(self.NAME, self.category, size=size, t=[0.0], position=[PARKED])

    def apply(self, plant: Simulation, level: float) -> None:
        """Move the person along the line."""
        if "line" not in plant.memory:
            heading, beside = plant.rng.uniform(-math.pi, math.pi), plant.rng.uniform(-self.passing, self.passing)
            along = np.array([math.cos(heading), math.sin(heading)])
            nearest = tool_at(plant, np.zeros(1))[0, :2] + beside * np.array([-along[1], along[0]])
            plant.memory["line"] = nearest, along, heading
        nearest, along, heading = plant.memory["line"]
        speed = level * self.amount
        walked = _so_far(plant, speed)
        rows = len(plant.walk) - plant.step
        way = walked + speed * plant.dt * np.arange(rows) - self.distance
        position = np.column_stack([nearest + way[:, None] * along, np.full(rows, self.height / 2.0)])
        go(plant, self.NAME, position, np.full(rows, heading))


@dataclass(frozen=True, kw_only=True)
class DoorOpens(Disturbance):
    """A door swings by 135 degrees through the tool's position at the onset, then stops.

    The door does not yield. Hitting it harms no entity, but may knock the carried object out of the gripper.

    Args:
        width: Width of the door [m].
        reach: Distance of the tool from the hinge [m].
    """

    width: float = 0.8
    reach: float = 0.65

    NAME: ClassVar[str] = "door_opens"
    PARAMETER: ClassVar[str] = "rate of turning [rad/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 1.0, "moderate": 2.0, "severe": 3.0, "critical": 5.0}

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.reach < self.width < math.inf:
            raise SettingError("reach, width", (self.reach, self.width), "0 < reach < width, finite [m]")

    def visitor(self) -> MovingEntity:
        """Return the door, parked away from the scene."""
        size = [self.width / 2.0, 0.02, 1.0]
        return MovingEntity(self.NAME, "none", size=size, t=[0.0], position=[PARKED])

    def apply(self, plant: Simulation, level: float) -> None:
        """Turn the door, from 90 degrees before the tool to 45 degrees beyond it."""
        if "hinge" not in plant.memory:
            bearing = plant.rng.uniform(-math.pi, math.pi)
            towards = np.array([math.cos(bearing), math.sin(bearing)])
            plant.memory["hinge"] = tool_at(plant, np.zeros(1))[0, :2] - self.reach * towards, bearing
        hinge, bearing = plant.memory["hinge"]
        rate = level * self.amount
        turned = _so_far(plant, rate)
        rows = len(plant.walk) - plant.step
        angle = np.minimum(turned + rate * plant.dt * np.arange(rows), 1.5 * _HALF_TURN)
        yaw = bearing - _HALF_TURN + angle
        centre = hinge + self.width / 2.0 * np.column_stack([np.cos(yaw), np.sin(yaw)])
        go(plant, self.NAME, np.column_stack([centre, np.full(rows, 1.0)]), yaw)


def _so_far(plant: Simulation, rate: float) -> float:
    """Return the distance or angle covered at earlier rates, and store the current rate."""
    done, since, before = plant.memory.get("so_far", (0.0, plant.step, 0.0))
    done += before * plant.dt * (plant.step - since)
    plant.memory["so_far"] = done, plant.step, rate
    return done

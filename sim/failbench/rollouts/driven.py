"""The contract of the loop that keeps a base on its motion, which a world without a base does without."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from failbench.simulated.world import World
from graceful_plan import Trajectory
from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.mobile.room import mobile_room

Array = np.ndarray

TICK = 10
"""Steps from one command of the loop to the next."""

Misreadings = Callable[[], Float[Array, " wheel"]]
"""Tells how wrong the readings of the wheels are now: reading minus truth [rad]."""


@runtime_checkable
class WheelLoop(Protocol):
    """One base on its way."""

    misread: Misreadings | None
    """How wrong the readings of the wheels are; None if they are right."""

    @property
    def angles(self) -> Float[Array, " wheel"]:
        """What its servos are told that the wheels' angles should be [rad]."""
        ...

    @property
    def summed(self) -> float:
        """Integral of commanded minus measured rate of turning [rad]."""
        ...

    def arrived(self, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"]) -> bool:
        """Whether a path that is not followed in time is done."""
        ...

    def commands(
        self, step: int, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"], lag: int = 0
    ) -> Float[Array, "tick wheel"]:
        """Return what the wheels' servos are sent in the steps of this tick.

        Args:
            step: Steps since the motion began.
            qpos: Positions of everything.
            qvel: Velocities.
            lag: Steps by which the speeds that the base is told arrive late.
        """
        ...


@runtime_checkable
class WheelPlan(Protocol):
    """What a base follows: made once for a motion."""

    @property
    def dt(self) -> float:
        """Time step [s]."""
        ...

    @property
    def wheel(self) -> Array:
        """Addresses of the wheels in qpos."""
        ...

    @property
    def motor(self) -> Array:
        """Their actuators."""
        ...

    @property
    def in_time(self) -> bool:
        """Whether the motion is followed in time; else its path is, and the controller takes its own time."""
        ...

    @property
    def seconds(self) -> float:
        """For how long it is followed at most [s]."""
        ...

    def loop(self, angles: Float[Array, " wheel"], summed: float = 0.0) -> WheelLoop:
        """Return a loop whose servos stand at these angles of the wheels [rad]."""
        ...


def wheel_plan(world: World, trajectory: Trajectory, controller: object = None) -> WheelPlan | None:
    """Return what a world's base follows; None if it does not drive.

    Args:
        world: Where.
        trajectory: The motion.
        controller: See `failbench.mobile.base_loop.BasePlan.of`.

    Raises:
        SettingError: If there is a controller for a robot that does not drive, or one that is none.
        UnsupportedError: If the robot drives, and the room of what drives is not installed.
    """
    if world.rolling is not None:
        plan: WheelPlan = mobile_room("base_loop", of="failbench").BasePlan.of(world, trajectory, controller)
        return plan
    if controller is not None:
        raise SettingError("controller", controller, "None: this robot does not drive")
    return None

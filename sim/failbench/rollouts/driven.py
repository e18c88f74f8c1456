"""Interface of the control loop of a driving base; robots without a base do not need it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from failbench.simulated.world import World
from graceful_plan import Trajectory
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.mobile.optional import import_mobile

TICK = 10
"""Steps between commands of the loop."""

Misreadings = Callable[[], Float[Array, " wheel"]]
"""Returns the current errors of the wheel readings: reading minus true angle [rad]."""


@runtime_checkable
class WheelLoop(Protocol):
    """Control loop of one driving base."""

    misread: Misreadings | None
    """Source of the errors of the wheel readings; None if they are right."""

    @property
    def angles(self) -> Float[Array, " wheel"]:
        """Target angles of the wheel servos [rad]."""
        ...

    @property
    def summed(self) -> float:
        """Integral of the commanded minus the measured yaw rate [rad]."""
        ...

    def arrived(self, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"]) -> bool:
        """Whether the base has arrived at the end of a path that it follows without a time law."""
        ...

    def commands(
        self, step: int, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"], lag: int = 0
    ) -> Float[Array, "tick wheel"]:
        """Return the wheel servos' commands for the steps of this tick.

        Args:
            step: Steps since the motion began.
            qpos: Positions of the whole model.
            qvel: Velocities of the whole model.
            lag: Delay of the base's commanded speeds, in steps.
        """
        ...


@runtime_checkable
class WheelPlan(Protocol):
    """The motion that a base follows, prepared once."""

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
        """Actuators of the wheels."""
        ...

    @property
    def in_time(self) -> bool:
        """Whether the base follows the motion's time law; otherwise it follows the path at its controller's pace."""
        ...

    @property
    def seconds(self) -> float:
        """Longest time that the base follows the motion [s]."""
        ...

    def loop(self, angles: Float[Array, " wheel"], summed: float = 0.0) -> WheelLoop:
        """Return a control loop that starts at these target angles of the wheels [rad]."""
        ...


def wheel_plan(world: World, trajectory: Trajectory, controller: object = None) -> WheelPlan | None:
    """Return the motion that a world's base follows; None if it does not drive.

    Args:
        world: The simulated world.
        trajectory: The motion.
        controller: See `failbench.mobile.base_loop.BasePlan.of`.

    Raises:
        SettingError: If a controller is given for a robot that does not drive, or is not a controller.
        UnsupportedError: If the robot drives and the package for mobile bases is not installed.
    """
    if world.rolling is not None:
        plan: WheelPlan = import_mobile("base_loop", of="failbench").BasePlan.of(world, trajectory, controller)
        return plan
    if controller is not None:
        raise SettingError("controller", controller, "None: this robot does not drive")
    return None

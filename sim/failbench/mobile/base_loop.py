"""Closed-loop wheel commands for a base that follows a motion, computed from its estimated pose.

A healthy base knows its true pose. From the onset of an encoder fault it uses odometry instead: the estimated pose
moves by the true motion plus the error of the wheel readings. The fault is the only source of odometry error.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from failbench.mobile.following import Controller, Course, CourseFollower, check_course, timed, untimed, within_reach
from failbench.mobile.slipping import fitted_tracking
from failbench.rollouts.driven import TICK, Misreadings
from failbench.simulated.rolling import Rolling
from failbench.simulated.world import World
from graceful_plan import Scene, Trajectory
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.coast.steering import FASTER
from graceful_plan.mobile.control.diff_drive_controller import Tracking
from graceful_plan.mobile.control.drive_state import DriveState

_SLACK = 0.5
"""Largest difference between the commanded and the measured angle of a wheel [rad]; limits integral wind-up."""


@dataclass(frozen=True, eq=False)
class BasePlan:
    """Data for following one motion, computed once per motion.

    | field      | meaning                                                     | shape |
    |------------|-------------------------------------------------------------|-------|
    | rolling    | the base's addresses in the model                           |       |
    | course     | states or path to follow                                    |       |
    | controller | the controller that follows the course                      |       |
    | scene      | scene the controller uses, without the carried object       |       |
    | dt         | time step [s]                                               |       |
    | wheel      | addresses of the wheels in qpos                             | wheel |
    | rim        | dofs of the wheels                                          | wheel |
    | motor      | actuators of the wheels                                     | wheel |
    | kp         | stiffness of the wheel servos                               | wheel |
    | kd         | damping of the wheel servos                                 | wheel |
    | reach      | largest change of rim speed from one tick to the next [m/s] |       |
    """

    rolling: Rolling
    course: Course
    controller: Controller
    scene: Scene
    dt: float
    wheel: Array
    rim: Array
    motor: Array
    kp: Float[Array, " wheel"]
    kd: Float[Array, " wheel"]
    reach: float

    @classmethod
    def of(cls, world: World, trajectory: Trajectory, controller: object = None) -> BasePlan:
        """Build the plan for the base of a world.

        Args:
            world: World with the base.
            trajectory: Motion to follow.
            controller: `Tracking` follows the motion in time, other controllers follow its path. Default: `Tracking`
                fitted to the base.

        Raises:
            SettingError: If `controller` is not a controller.
        """
        assert world.rolling is not None
        n, robot, dt = len(world.rolling.base.wheels), world.robot, world.settings.timestep
        scene = world.scene if world.scene.carried is None else world.scene.detach()
        chosen = fitted_tracking(scene) if controller is None else controller
        if not isinstance(chosen, Controller):
            raise SettingError("controller", chosen, "a Tracking, a PurePursuit or a DynamicWindow")
        in_time = isinstance(chosen, Tracking)
        course = timed(trajectory, dt, trajectory.duration + dt) if in_time else untimed(trajectory, dt)
        check_course(chosen, course)
        return cls(
            rolling=world.rolling,
            course=course,
            controller=chosen,
            scene=scene,
            dt=dt,
            wheel=robot.qpos[:n],
            rim=robot.dofs[:n],
            motor=robot.actuators[:n],
            kp=robot.kp[:n],
            kd=robot.kd[:n],
            reach=TICK * dt * _hardest(world),
        )

    @property
    def in_time(self) -> bool:
        """Whether the controller follows the motion in time."""
        return self.course.wanted is not None

    @property
    def seconds(self) -> float:
        """Longest time the motion is followed [s]."""
        return self.course.seconds

    def loop(self, angles: Float[Array, " wheel"], summed: float = 0.0) -> BaseLoop:
        """Return a loop whose servos start at these wheel angles [rad]."""
        return BaseLoop(self, np.array(angles, dtype=float), summed)


@dataclass(eq=False)
class BaseLoop:
    """Control loop of one base that follows its plan.

    Args:
        plan: Plan to follow.
        angles: Commanded angles of the wheels [rad].
        summed: Integral of commanded minus measured turning rate [rad].
        misread: Errors of the wheel readings; None if the readings are correct.
    """

    plan: BasePlan
    angles: Float[Array, " wheel"]
    summed: float = 0.0
    misread: Misreadings | None = None
    follower: CourseFollower = field(init=False)
    _believed: tuple[float, float, float] | None = field(default=None, init=False)
    _told: list[Array] = field(default_factory=list, init=False)
    """Commanded wheel rates: the initial measured rates, then one entry per tick [rad/s]."""
    _before: tuple[tuple[float, float, float], Array] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        plan = self.plan
        self.follower = CourseFollower(plan.controller, plan.course, plan.scene, plan.dt, TICK * plan.dt)

    def arrived(self, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"]) -> bool:
        """Whether the base has reached the end of its path, for controllers without a time law."""
        return self.follower.arrived(DriveState(*self.plan.rolling.drives(qpos, qvel)))

    def commands(
        self, step: int, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"], lag: int = 0
    ) -> Float[Array, "tick wheel"]:
        """Return the wheel servo commands for the steps of this tick.

        Args:
            step: Steps since the motion began.
            qpos: Positions of the whole model.
            qvel: Velocities of the whole model.
            lag: Delay of the speed commands in steps; the servos integrate the delayed commands.
        """
        plan, base = self.plan, self.plan.rolling.base
        x, y, yaw, v, omega = plan.rolling.drives(qpos, qvel)
        state = DriveState(*self._place((x, y, yaw)), v, omega)
        command = self.follower.command(state, step)
        summed = self.follower.gains.summed(self.summed, command, state, TICK * plan.dt)
        wanted = self.follower.gains.held(command, state, summed)
        turning = qvel[plan.rim]
        told = within_reach(wanted, self._told[-1] if self._told else turning, turning, base, plan.reach)
        if told.omega == wanted.omega or abs(summed) < abs(self.summed):
            self.summed = summed
        half = len(plan.wheel) // 2
        side = np.concatenate([-np.ones(half), np.ones(half)])
        rates = np.clip((told.v + side * base.lever * told.omega) / base.radius, *_rim(base.rim_max / base.radius))
        read = qpos[plan.wheel] + (0.0 if self.misread is None else self.misread())
        self.angles = np.clip(self.angles, read - _SLACK, read + _SLACK)
        self._told += [rates] if self._told else [qvel[plan.rim].copy(), rates]
        ticks = len(self._told) - 1 + (np.arange(TICK) - lag) // TICK
        arrived = np.array([self._told[max(0, tick)] for tick in ticks])
        after = self.angles + plan.dt * np.cumsum(arrived, axis=0)
        self.angles = after[-1]
        return after + plan.kd / plan.kp * arrived

    def _place(self, truth: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the estimated pose of the base."""
        if self.misread is None:
            return truth
        wrong = self.misread()
        if self._believed is None or self._before is None:
            self._believed = truth
        else:
            (x, y, yaw), before = self._before
            c, s = np.cos(yaw), np.sin(yaw)
            dx, dy = truth[0] - x, truth[1] - y
            base, half = self.plan.rolling.base, len(wrong) // 2
            rims = base.radius * (wrong - before)
            left, right = float(rims[:half].mean()), float(rims[half:].mean())
            along, across = c * dx + s * dy + 0.5 * (left + right), -s * dx + c * dy
            bx, by, heading = self._believed
            c, s = np.cos(heading), np.sin(heading)
            turned = truth[2] - yaw + 0.5 * (right - left) / base.lever
            self._believed = (bx + c * along - s * across, by + s * along + c * across, heading + turned)
        self._before = truth, wrong
        return self._believed


def _hardest(world: World) -> float:
    """Return the greatest straight-line acceleration that the motors of a base can give [m/s^2]."""
    assert world.rolling is not None
    model, robot, base = world.model, world.robot, world.rolling.base
    n = len(base.wheels)
    mass = float(model.body_subtreemass[model.dof_bodyid[world.rolling.dofs[2]]])
    rotors = float(model.dof_armature[robot.dofs[:n]].sum())
    force = float(model.actuator_forcerange[robot.actuators[:n], 1].sum()) / base.radius
    return force / (mass + rotors / base.radius**2)


def _rim(most: float) -> tuple[float, float]:
    """Return bounds of the wheel rates, with a reserve for tracking corrections at the greatest speed."""
    return -FASTER * most, FASTER * most

"""Closed-loop driving on wheels, with moving entities and optional failures, and measurements of the result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from failbench.basics.errors import ExecutionRefused
from failbench.mobile.following import (
    SETTLES,
    SLOW,
    THERE,
    Controller,
    Course,
    CourseFollower,
    check_course,
    subsampled_points,
    timed,
    untimed,
)
from failbench.mobile.slipping import fitted_tracking
from failbench.mobile.wheeled import TIMESTEP, Wheeled, wheeled
from failbench.report import ValidationReport
from failbench.validation import Scenarios, validate
from graceful_plan import Path, PlanResult, Scene, Trajectory, retime
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.control.diff_drive_controller import Tracking
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState
from graceful_plan.path import real_array


@dataclass(frozen=True, eq=False, kw_only=True)
class Driven:
    """Result of a drive.

    | field    | meaning                                                                  | unit      |
    |----------|--------------------------------------------------------------------------|-----------|
    | t        | sample times                                                             | s         |
    | pose     | pose of the base: x, y, heading                                          | m, m, rad |
    | speed    | speed along the heading                                                  | m/s       |
    | error    | distance to the reference position; to the path, if it has no times      | m         |
    | across   | distance to the nearest point of the motion                              | m         |
    | touched  | names of touched bodies and moving entities, with times of first contact | s         |
    | arrived  | whether the base reached the end and stopped there                       |           |
    | chosen   | number of commands, and number of emergency stops among them             |           |
    | failures | report of harm from the simulated failures; None without faults          |           |
    """

    t: Float[Array, " sample"]
    pose: Float[Array, "sample 3"]
    speed: Float[Array, " sample"]
    error: Float[Array, " sample"]
    across: Float[Array, " sample"]
    touched: Mapping[str, float] = field(default_factory=dict)
    arrived: bool = False
    chosen: tuple[int, int] = (0, 0)
    failures: ValidationReport | None = None

    @property
    def duration(self) -> float:
        """Duration of the drive [s]."""
        return float(self.t[-1])


def drive_base(
    motion: Trajectory | PlanResult | Float[Array, "n 2"],
    scene: Scene,
    controller: Controller | None = None,
    *,
    faults: Scenarios = (),
    n: int = 60,
    horizon: float = 4.0,
    seed: int = 0,
    start: Float[Array, " nq"] | None = None,
    seconds: float | None = None,
) -> Driven:
    """Drive a base on rotating wheels with a controller, optionally with failures on the way.

    Moving entities of the scene move as predicted. A `DynamicWindow` sees them, and they exert no forces. Failures are
    those of `validate(motion, scene, faults, controller=controller)`: the controller keeps running after failure onset.

    Args:
        motion: A trajectory or the result of `plan`; or places on the floor, for controllers that need no times.
        scene: Scene to drive in. Its carried object is present in the failure runs and absent in the healthy drive.
        controller: `Tracking` follows a motion in time; `PurePursuit` and `DynamicWindow` follow its path. Default:
            `fitted_tracking(scene)`.
        faults: Faults to simulate: patterns of the registry's tags or names such as "power/*/severe", or faults.
        n: Number of failures, rounded up to a multiple of the number of faults.
        horizon: Simulated time after failure onset [s].
        seed: Random seed.
        start: Start configuration. Default: the start of the motion.
        seconds: Longest duration of the drive [s]. Default: with `Tracking`, the motion's duration plus a settling
            time; otherwise three times the duration plus 5 s, and 20 s for a path.

    Raises:
        UnsupportedError: If the scene's robot cannot be put on wheels.
        SettingError: If a path is to be tracked in time, or `start` is given together with faults.
        ExecutionRefused: If faults are given and the healthy base does not arrive.
    """
    bare = scene if scene.carried is None else scene.detach()
    chosen = fitted_tracking(bare) if controller is None else controller
    if faults and start is not None:
        raise SettingError("start", start, "None with faults: the drive starts where the motion starts")
    q0, course = _course(motion, scene, chosen, start, seconds)
    wheels = wheeled(bare)
    loop = _Loop(wheels, CourseFollower(chosen, course, bare, TIMESTEP))
    rows = list(loop.run(wheels.placed(q0, 0.0, 0.0)))
    driven = _driven(rows, loop)
    if not faults:
        return driven
    if not driven.arrived:
        raise ExecutionRefused(
            "the base", driven.duration, "it has not arrived; call `drive` without faults to see where it stops"
        )
    followed = motion if isinstance(motion, Trajectory | PlanResult) else _along(course.path, q0, scene)
    report = validate(followed, scene, faults, controller=chosen, n=n, horizon=horizon, seed=seed)
    return replace(driven, failures=report)


def _driven(rows: list[tuple[float, tuple[float, float, float], float]], loop: _Loop) -> Driven:
    t, pose, speed = np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), np.array([r[2] for r in rows])
    course = loop.follower.course
    across = _to_polyline(pose[:, :2], course.path)
    if course.wanted is None:
        error = across
    else:
        at = np.minimum(np.round(t / TIMESTEP).astype(int), len(course.wanted) - 1)
        error = np.linalg.norm(pose[:, :2] - course.wanted[at, :2], axis=1)
    ended = np.linalg.norm(pose[-1, :2] - course.path[-1]) < THERE and abs(speed[-1]) < 5 * SLOW
    return Driven(
        t=t,
        pose=pose,
        speed=speed,
        error=error,
        across=across,
        touched=loop.touched,
        arrived=bool(ended),
        chosen=(loop.follower.commands, loop.follower.stops),
    )


def _course(
    motion: Trajectory | PlanResult | Float[Array, "n 2"],
    scene: Scene,
    controller: Controller,
    start: Float[Array, " nq"] | None,
    seconds: float | None,
) -> tuple[Float[Array, " nq"], Course]:
    if isinstance(motion, PlanResult):
        motion = motion.unwrap()
    if isinstance(motion, Trajectory):
        q0 = motion.q[0] if start is None else real_array("start", start)
        if isinstance(controller, Tracking):
            return q0, timed(motion, TIMESTEP, motion.duration + SETTLES if seconds is None else seconds)
        return q0, untimed(motion, TIMESTEP, seconds)
    path = real_array("motion", motion)
    if path.ndim != 2 or path.shape[1] < 2 or not len(path) or not np.isfinite(path).all():
        raise SettingError("motion", path.shape, "a trajectory, or places on the floor (n, 2)")
    course = Course(None, path[:, :2], 20.0 if seconds is None else seconds)
    check_course(controller, course)
    q0 = scene.home_qpos[list(scene.qpos_adr)] if start is None else real_array("start", start)
    if start is None:
        ahead = path[min(1, len(path) - 1), :2] - path[0, :2]
        q0[:3] = *path[0, :2], math.atan2(ahead[1], ahead[0])
    return q0, course


def _along(path: Float[Array, "n 2"], q0: Float[Array, " nq"], scene: Scene) -> Trajectory:
    """Return a trajectory along a path; its times are arbitrary, as path followers use only its positions."""
    q = np.tile(q0, (len(path), 1))
    q[:, :2] = path
    return retime(Path(q), scene.limits, scene.joints)


class _Loop:
    """Closed loop of a controller and the simulation."""

    def __init__(self, wheels: Wheeled, follower: CourseFollower) -> None:
        self.wheels, self.follower = wheels, follower
        self.touched: dict[str, float] = {}
        self._summed = 0.0

    def run(self, data: mujoco.MjData) -> Iterator[tuple[float, tuple[float, float, float], float]]:
        """Yield time, pose and speed after each command; `data` is modified."""
        follower = self.follower
        each = max(1, round(follower.period / TIMESTEP))
        for step in range(0, round(follower.course.seconds / TIMESTEP), each):
            state = self.state(data)
            if follower.arrived(state):
                return
            command = follower.command(state, step)
            for _ in range(each):
                self._turn_wheels(data, command)
                mujoco.mj_step(self.wheels.model, data)
                self._note(data)
            yield (step + each) * TIMESTEP, self.wheels.pose(data), self.state(data).v

    def state(self, data: mujoco.MjData) -> DriveState:
        """Return the pose and the speeds of the base."""
        x, y, yaw = self.wheels.pose(data)
        vx, vy = data.qvel[self.wheels.dof : self.wheels.dof + 2]
        v = float(vx * math.cos(yaw) + vy * math.sin(yaw))
        return DriveState(x, y, yaw, v, float(data.qvel[self.wheels.dof + 5]))

    def _turn_wheels(self, data: mujoco.MjData, command: DriveCommand) -> None:
        state = DriveState(0.0, 0.0, 0.0, 0.0, float(data.qvel[self.wheels.dof + 5]))
        self._summed = self.follower.gains.summed(self._summed, command, state, TIMESTEP)
        told = self.follower.gains.held(command, state, self._summed)
        data.ctrl[self.wheels.motor] = self.wheels.wheel_rates(told.v, told.omega)

    def _note(self, data: mujoco.MjData) -> None:
        wheels = self.wheels
        for k in range(data.ncon):
            first, second = int(data.contact.geom1[k]), int(data.contact.geom2[k])
            if data.contact.dist[k] > 0.0 or (first in wheels.robot) == (second in wheels.robot):
                continue
            other = second if first in wheels.robot else first
            if other not in wheels.floor:
                name = wheels.model.body(int(wheels.model.geom_bodyid[other])).name or "world"
                self.touched.setdefault(name, float(data.time))


def _to_polyline(points: Float[Array, "n 2"], path: Float[Array, "k 2"]) -> Float[Array, " n"]:
    """Return the distances of points to a polyline [m]."""
    path = subsampled_points(path)
    begin, way = path[:-1], np.diff(path, axis=0)
    if not len(way):
        return np.linalg.norm(points - path[0], axis=1)
    squared = np.maximum((way**2).sum(axis=1), 1e-12)
    t = np.clip(((points[:, None] - begin) * way).sum(axis=-1) / squared, 0.0, 1.0)
    return np.linalg.norm(begin + t[..., None] * way - points[:, None], axis=-1).min(axis=1)

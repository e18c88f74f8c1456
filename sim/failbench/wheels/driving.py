"""Driving on wheels: a controller closes the loop, things walk, the base fails, and what comes of that is measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import mujoco
import numpy as np

from failbench.wheels.slipping import fitted_tracking
from failbench.wheels.wheeled import TIMESTEP, Wheeled, wheeled
from graceful_plan import PlanResult, Scene, Trajectory
from graceful_plan.array_types import Float
from graceful_plan.control.diff_drive_controller import Tracking, drive_states, limited
from graceful_plan.control.drive_state import DriveCommand, DriveState
from graceful_plan.control.dwa import DynamicWindow, seen
from graceful_plan.control.pure_pursuit import PurePursuit
from graceful_plan.exceptions import SettingError

Array = np.ndarray

Controller = Tracking | PurePursuit | DynamicWindow

PERIOD = 0.02
"""Between commands of controllers that have no period of their own [s]."""
_SETTLES = 0.5
"""How long the robot is watched after the end [s]."""
_THERE = 0.08
"""Distance to the end of a path at which it counts as reached [m]."""
_SLOW = 0.02


@dataclass(frozen=True, eq=False, kw_only=True)
class Driven:
    """What came of driving.

    | field    | meaning                                                                        | unit        |
    |----------|--------------------------------------------------------------------------------|-------------|
    | t        | times of samples                                                               | s           |
    | pose     | where the base was: x, y, heading                                              | m, m, rad   |
    | speed    | along its heading                                                              | m/s         |
    | error    | distance to where it should have been; to the path, if that has no times       | m           |
    | across   | distance to the nearest place of the motion                                    | m           |
    | touched  | names of bodies, and of moving entities, that it touched, and when first       | s           |
    | arrived  | whether it came to the end and stood there                                     |             |
    | chosen   | how many commands were asked for, and how many of them were emergency stops    |             |
    """

    t: Float[Array, " sample"]
    pose: Float[Array, "sample 3"]
    speed: Float[Array, " sample"]
    error: Float[Array, " sample"]
    across: Float[Array, " sample"]
    touched: Mapping[str, float] = field(default_factory=dict)
    arrived: bool = False
    chosen: tuple[int, int] = (0, 0)

    @property
    def duration(self) -> float:
        """How long it drove [s]."""
        return float(self.t[-1])


class _Goal(NamedTuple):
    """What is followed: states in time steps, or a path that has none."""

    wanted: Float[Array, "step 5"] | None
    path: Float[Array, "n 2"]


def drive(
    motion: Trajectory | PlanResult | Float[Array, "n 2"],
    scene: Scene,
    controller: Controller | None = None,
    *,
    start: Float[Array, " nq"] | None = None,
    seconds: float | None = None,
) -> Driven:
    """Drive a base on wheels that turn, with a controller.

    Moving entities of the scene walk as predicted, are seen by a `DynamicWindow`, and push nothing.

    Args:
        motion: A trajectory or the result of `plan`; or places on the floor, for controllers that need no times.
        scene: Where.
        controller: `Tracking` follows a motion in time, `PurePursuit` and a `DynamicWindow` its path. Default:
            `fitted_tracking(scene)`.
        start: Configuration from which it drives; where the motion begins by default.
        seconds: How long it drives at most; default: what the motion takes, thrice that without times, and at least
            20 s for paths.

    Raises:
        UnsupportedError: If the scene's robot cannot be put on wheels.
        SettingError: If a path is to be tracked in time.
    """
    wheels, chosen = wheeled(scene), fitted_tracking(scene) if controller is None else controller
    q0, goal, limit = _goal(motion, scene, chosen, start, seconds)
    data = wheels.placed(q0, 0.0, 0.0)
    loop = _Loop(wheels, chosen, goal, limit)
    rows = list(loop.run(data))
    t, pose, speed = np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), np.array([r[2] for r in rows])
    dense = goal.path if goal.wanted is None else goal.wanted[:, :2]
    across = _to_polyline(pose[:, :2], dense)
    if goal.wanted is None:
        error = across
    else:
        at = np.minimum(np.round(t / TIMESTEP).astype(int), len(goal.wanted) - 1)
        error = np.linalg.norm(pose[:, :2] - goal.wanted[at, :2], axis=1)
    ended = np.linalg.norm(pose[-1, :2] - dense[-1]) < _THERE and abs(speed[-1]) < 5 * _SLOW
    return Driven(
        t=t,
        pose=pose,
        speed=speed,
        error=error,
        across=across,
        touched=loop.touched,
        arrived=bool(ended),
        chosen=(loop.commands, loop.stops),
    )


def _goal(
    motion: Trajectory | PlanResult | Float[Array, "n 2"],
    scene: Scene,
    controller: Controller,
    start: Float[Array, " nq"] | None,
    seconds: float | None,
) -> tuple[Float[Array, " nq"], _Goal, float]:
    if isinstance(motion, PlanResult):
        motion = motion.unwrap()
    if isinstance(motion, Trajectory):
        t = np.arange(0.0, motion.duration + _SETTLES, TIMESTEP)
        state = motion.at(motion.t[0] + np.minimum(t, motion.duration))
        wanted = drive_states(state.q, state.qd)
        wanted[t >= motion.duration, 3:] = 0.0
        q0 = state.q[0] if start is None else np.asarray(start, dtype=float)
        if isinstance(controller, Tracking):
            return q0, _Goal(wanted, wanted[:, :2]), float(t[-1]) if seconds is None else seconds
        return q0, _Goal(None, _thinned(wanted[:, :2])), 3.0 * motion.duration + 5.0 if seconds is None else seconds
    path = np.asarray(motion, dtype=float)
    if path.ndim != 2 or path.shape[1] < 2 or not len(path) or not np.isfinite(path).all():
        raise SettingError("motion", path.shape, "a trajectory, or places on the floor (n, 2)")
    if isinstance(controller, Tracking):
        raise SettingError("controller", controller, "PurePursuit or a DynamicWindow: a path has no times to track")
    q0 = np.zeros(len(scene.joints)) if start is None else np.asarray(start, dtype=float)
    if start is None:
        ahead = path[min(1, len(path) - 1), :2] - path[0, :2]
        q0[:3] = *path[0, :2], math.atan2(ahead[1], ahead[0])
    return q0, _Goal(None, path[:, :2]), 20.0 if seconds is None else seconds


class _Loop:
    """A controller and the simulation that it is closed with."""

    def __init__(self, wheels: Wheeled, controller: Controller, goal: _Goal, seconds: float) -> None:
        self.wheels, self.controller, self.goal = wheels, controller, goal
        self.period = controller.settings.period if isinstance(controller, DynamicWindow) else PERIOD
        self.seconds = seconds
        self.touched: dict[str, float] = {}
        self.commands = self.stops = 0
        self._summed = 0.0
        self._last = DriveCommand(0.0, 0.0)

    def run(self, data: mujoco.MjData) -> Iterator[tuple[float, tuple[float, float, float], float]]:
        """Yield time, pose and speed after each command; the data are changed."""
        each = max(1, round(self.period / TIMESTEP))
        for step in range(0, int(self.seconds / TIMESTEP), each):
            state = self.state(data)
            if self._arrived(state, step):
                return
            command = self._command(state, step)
            for _ in range(each):
                self._turn_wheels(data, command)
                mujoco.mj_step(self.wheels.model, data)
                self._note(data)
            yield (step + each) * TIMESTEP, self.wheels.pose(data), self.state(data).v

    def state(self, data: mujoco.MjData) -> DriveState:
        """Return where the base is and how fast it drives."""
        x, y, yaw = self.wheels.pose(data)
        vx, vy = data.qvel[self.wheels.dof : self.wheels.dof + 2]
        v = float(vx * math.cos(yaw) + vy * math.sin(yaw))
        return DriveState(x, y, yaw, v, float(data.qvel[self.wheels.dof + 5]))

    def _arrived(self, state: DriveState, step: int) -> bool:
        if self.goal.wanted is not None or not step:
            return False
        x, y = self.goal.path[-1]
        near = math.hypot(state.x - x, state.y - y) < _THERE
        return near and abs(state.v) < _SLOW and abs(state.omega) < 5 * _SLOW

    def _command(self, state: DriveState, step: int) -> DriveCommand:
        controller, base = self.controller, self.wheels.base
        self.commands += 1
        if isinstance(controller, Tracking):
            assert self.goal.wanted is not None
            lead = round((controller.lead + 0.5 * self.period) / TIMESTEP)
            now = self.goal.wanted[min(step, len(self.goal.wanted) - 1)]
            ahead = self.goal.wanted[min(step + lead, len(self.goal.wanted) - 1)]
            return controller.command(state, DriveState(*now[:3], *ahead[3:]))
        if isinstance(controller, PurePursuit):
            self._last = limited(controller.command(state, self.goal.path, base), self._last, base, self.period)
            return self._last
        choice = controller.choose(state, self.goal.path, seen(self.wheels.scene, step * TIMESTEP))
        self.stops += not choice.admissible
        return choice.command

    def _turn_wheels(self, data: mujoco.MjData, command: DriveCommand) -> None:
        gains = self.controller if isinstance(self.controller, Tracking) else Tracking()
        state = DriveState(0.0, 0.0, 0.0, 0.0, float(data.qvel[self.wheels.dof + 5]))
        self._summed += TIMESTEP * (command.omega - state.omega)
        told = gains.held(command, state, self._summed)
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


def _thinned(path: Float[Array, "n 2"]) -> Float[Array, "k 2"]:
    """Leave out places that are nearer than 2 cm to the one before, the last one excepted."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    _, kept = np.unique(np.floor(s / 0.02), return_index=True)
    return path[np.unique([*kept, len(path) - 1])]


def _to_polyline(points: Float[Array, "n 2"], path: Float[Array, "k 2"]) -> Float[Array, " n"]:
    """Return the distance of points to a polyline [m]."""
    path = _thinned(path)
    begin, way = path[:-1], np.diff(path, axis=0)
    if not len(way):
        return np.linalg.norm(points - path[0], axis=1)
    squared = np.maximum((way**2).sum(axis=1), 1e-12)
    t = np.clip(((points[:, None] - begin) * way).sum(axis=-1) / squared, 0.0, 1.0)
    return np.linalg.norm(begin + t[..., None] * way - points[:, None], axis=-1).min(axis=1)

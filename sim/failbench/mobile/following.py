"""What a controller tells a base: in time along a motion, or along its path as fast as the controller chooses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graceful_plan import Scene, Trajectory
from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.coast.steering import BEHIND
from graceful_plan.mobile.control.diff_drive_controller import Tracking, drive_states, limited
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState
from graceful_plan.mobile.control.dwa import DynamicWindow, seen
from graceful_plan.mobile.control.pure_pursuit import PurePursuit
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Array = np.ndarray

Controller = Tracking | PurePursuit | DynamicWindow

PERIOD = 0.02
"""Between commands of controllers that have no period of their own [s]."""
SETTLES = 0.5
"""How long the robot is watched after the end of a motion [s]."""
THERE = 0.08
"""Distance to the end of a path at which it counts as reached [m]."""
SLOW = 0.02
_APART = 0.02
"""Least distance between places of a path [m]."""


class Course(NamedTuple):
    """What is followed: states in time steps, or a path that has none; and for how long at most."""

    wanted: Float[Array, "step 5"] | None
    """x, y, heading, speed and rate of turning at each time step, from the beginning on; the last one holds."""
    path: Float[Array, "n 2"]
    seconds: float
    begins: float = 0.0
    """On the clock of those who move [s]."""


def timed(motion: Trajectory, dt: float, seconds: float) -> Course:
    """Return a motion to be followed in time.

    Args:
        motion: Of a base, and of an arm that may be on it.
        dt: Time step [s].
        seconds: For how long.
    """
    t = np.arange(0.0, seconds + 0.5 * dt, dt)
    state = motion.at(motion.t[0] + np.minimum(t, motion.duration))
    wanted = drive_states(state.q, state.qd)
    wanted[t >= motion.duration - 1e-9, 3:] = 0.0
    return Course(wanted, wanted[:, :2], seconds, float(motion.t[0]))


def untimed(motion: Trajectory, dt: float, seconds: float | None = None) -> Course:
    """Return the path of a motion; thrice its time, and 5 s, is enough for it by default."""
    whole = timed(motion, dt, motion.duration)
    limit = 3.0 * motion.duration + 5.0 if seconds is None else seconds
    return Course(None, thinned(whole.path), limit, whole.begins)


def thinned(path: Float[Array, "n 2"]) -> Float[Array, "k 2"]:
    """Leave out places that are nearer than 2 cm to the one before, the last one excepted."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    _, kept = np.unique(np.floor(s / _APART), return_index=True)
    return path[np.unique([*kept, len(path) - 1])]


def check_course(controller: Controller, course: Course) -> None:
    """Raise SettingError if a path is to be followed in time."""
    if isinstance(controller, Tracking) and course.wanted is None:
        raise SettingError("controller", controller, "PurePursuit or a DynamicWindow: a path has no times to track")


@dataclass(eq=False)
class CourseFollower:
    """A controller on its way.

    Args:
        controller: What decides.
        course: What it follows.
        scene: Where.
        dt: Time step [s].
        period: Between commands, of controllers that have no period of their own [s].
    """

    controller: Controller
    course: Course
    scene: Scene
    dt: float
    period: float = PERIOD
    commands: int = 0
    """How many it gave."""
    stops: int = 0
    """How many of these were emergency stops."""
    _last: DriveCommand | None = None
    _next: float = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.controller, DynamicWindow):
            self.period = self.controller.settings.period

    @property
    def gains(self) -> Tracking:
        """Those of the loop over the rate of turning."""
        return self.controller if isinstance(self.controller, Tracking) else Tracking()

    def arrived(self, state: DriveState) -> bool:
        """Whether a path that has no times is done; a motion in time takes its time."""
        if self.course.wanted is not None or not self.commands:
            return False
        x, y = self.course.path[-1]
        near = math.hypot(state.x - x, state.y - y) < THERE
        return near and abs(state.v) < SLOW and abs(state.omega) < 5 * SLOW

    def command(self, state: DriveState, step: int) -> DriveCommand:
        """Return what the base is to do; what it was told last, if its next command is not due yet.

        Args:
            state: Where it is believed to be.
            step: Time steps since the beginning.
        """
        now = step * self.dt
        if self._last is None or now >= self._next - 1e-9:
            before = DriveCommand(state.v, state.omega) if self._last is None else self._last
            self._last = self._chosen(state, step, before)
            self._next = self.period * (math.floor(now / self.period + 1e-6) + 1)
            self.commands += 1
        return self._last

    def _chosen(self, state: DriveState, step: int, before: DriveCommand) -> DriveCommand:
        controller, course = self.controller, self.course
        if isinstance(controller, Tracking):
            assert course.wanted is not None
            last = len(course.wanted) - 1
            lead = round((controller.lead + 0.5 * self.period) / self.dt)
            now, ahead = course.wanted[min(step, last)], course.wanted[min(step + lead, last)]
            return controller.command(state, DriveState(*now[:3], *ahead[3:]))
        if isinstance(controller, PurePursuit):
            assert self.scene.base is not None
            told = controller.command(state, course.path, self.scene.base)
            return limited(told, before, self.scene.base, self.period)
        choice = controller.choose(state, course.path, seen(self.scene, course.begins + step * self.dt))
        self.stops += not choice.admissible
        return choice.command


def within_reach(
    wanted: DriveCommand,
    before: Float[Array, " wheel"],
    turning: Float[Array, " wheel"],
    base: DiffDrive,
    reach: float,
) -> DriveCommand:
    """Return what comes nearest to a command that the wheels can do before the next one.

    Half of what motors give is kept for the speed: a base that asks for more turning than they have would stand and
    spin.

    Args:
        wanted: What the base should do.
        before: Rates of the wheels that were asked for last, left ones first [rad/s]; where wheels are far from them,
            the wheels count.
        turning: Rates that they have [rad/s].
        base: How it drives.
        reach: By how much the rims can get faster until then [m/s].
    """
    rims = base.radius * np.clip(before, turning - BEHIND, turning + BEHIND)
    half = len(rims) // 2
    left, right = float(rims[:half].mean()), float(rims[half:].mean())
    v, turn, lever = 0.5 * (left + right), 0.5 * (right - left), base.lever
    faster = min(max(wanted.v - v, -0.5 * reach), 0.5 * reach)
    room = reach - abs(faster)
    more = lever * wanted.omega - turn
    omega = wanted.omega if abs(more) <= room else (turn + np.copysign(room, more)) / lever
    return DriveCommand(v + faster, float(omega))

"""Commands of a controller that follows a motion in time, or its path at a speed the controller chooses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graceful_plan import Scene, Trajectory
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.coast.steering import BEHIND
from graceful_plan.mobile.control.diff_drive_controller import Tracking, drive_states, limited
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState
from graceful_plan.mobile.control.dwa import DynamicWindow, seen
from graceful_plan.mobile.control.pure_pursuit import PurePursuit
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Controller = Tracking | PurePursuit | DynamicWindow

PERIOD = 0.02
"""Command period of controllers without their own period [s]."""
SETTLES = 0.5
"""Observation time after the end of a motion [s]."""
THERE = 0.08
"""Distance to the end of a path at which it counts as reached [m]."""
SLOW = 0.02
_APART = 0.02
"""Smallest distance between points of a subsampled path [m]."""


class Course(NamedTuple):
    """Reference to follow: states at time steps, or a path without times; and the longest duration [s]."""

    wanted: Float[Array, "step 5"] | None
    """x, y, heading, speed and turning rate at each time step from the start; the last state is held."""
    path: Float[Array, "n 2"]
    seconds: float
    begins: float = 0.0
    """Start time on the clock of the moving entities [s]."""


def timed(motion: Trajectory, dt: float, seconds: float) -> Course:
    """Return a course that follows a motion in time.

    Args:
        motion: Motion of the base, including the joints of its arm if it has one.
        dt: Time step [s].
        seconds: Duration [s].
    """
    t = np.arange(0.0, seconds + 0.5 * dt, dt)
    state = motion.at(motion.t[0] + np.minimum(t, motion.duration))
    wanted = drive_states(state.q, state.qd)
    wanted[t >= motion.duration - 1e-9, 3:] = 0.0
    return Course(wanted, wanted[:, :2], seconds, float(motion.t[0]))


def untimed(motion: Trajectory, dt: float, seconds: float | None = None) -> Course:
    """Return a course along the path of a motion; the default limit is three times the motion's duration plus 5 s."""
    whole = timed(motion, dt, motion.duration)
    limit = 3.0 * motion.duration + 5.0 if seconds is None else seconds
    return Course(None, subsampled_points(whole.path), limit, whole.begins)


def subsampled_points(path: Float[Array, "n 2"]) -> Float[Array, "k 2"]:
    """Subsample a path to about one point per 2 cm of its length; the last point is kept."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    _, kept = np.unique(np.floor(s / _APART), return_index=True)
    return path[np.unique([*kept, len(path) - 1])]


def check_course(controller: Controller, course: Course) -> None:
    """Raise SettingError if the controller tracks in time and the course has no times."""
    if isinstance(controller, Tracking) and course.wanted is None:
        raise SettingError("controller", controller, "PurePursuit or a DynamicWindow: a path has no times to track")


@dataclass(eq=False)
class CourseFollower:
    """State of a controller while it follows a course.

    Args:
        controller: Controller that chooses the commands.
        course: Course to follow.
        scene: Scene to drive in.
        dt: Time step [s].
        period: Command period of controllers without their own period [s].
    """

    controller: Controller
    course: Course
    scene: Scene
    dt: float
    period: float = PERIOD
    commands: int = 0
    """Number of commands."""
    stops: int = 0
    """Number of emergency stops among the commands."""
    _last: DriveCommand | None = None
    _next: float = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.controller, DynamicWindow):
            self.period = self.controller.settings.period

    @property
    def gains(self) -> Tracking:
        """Gains of the loop on the turning rate."""
        return self.controller if isinstance(self.controller, Tracking) else Tracking()

    def arrived(self, state: DriveState) -> bool:
        """Whether the base has reached the end of a path without times; always False for a motion followed in time."""
        if self.course.wanted is not None or not self.commands:
            return False
        x, y = self.course.path[-1]
        near = math.hypot(state.x - x, state.y - y) < THERE
        return near and abs(state.v) < SLOW and abs(state.omega) < 5 * SLOW

    def command(self, state: DriveState, step: int) -> DriveCommand:
        """Return the current command; the previous command is held until the next one is due.

        Args:
            state: Estimated state of the base.
            step: Time steps since the start.
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
    """Return the nearest command that the wheels can reach before the next command.

    Speed changes get at most half of the available acceleration; the rest is reserved for turning. Without the limit, a
    base whose requested turning exceeds its motors would stop and spin.

    Args:
        wanted: Desired command.
        before: Wheel rates commanded last, left ones first [rad/s]. They are clamped to within `BEHIND` of `turning`.
        turning: Measured wheel rates [rad/s].
        base: Parameters of the base.
        reach: Largest change of rim speed until the next command [m/s].
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

r"""Pure pursuit: follow a path along arcs to a point some distance ahead on it.

The arc from the base to a point at distance L and angle :math:`\alpha` off the heading has the curvature
:math:`2 \sin \alpha / L`. R. C. Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.mobile.control.drive_state import (
    DriveCommand,
    DriveState,
    check_numbers,
    checked_places,
    checked_state,
    wrapped,
)
from graceful_plan.path import plain_numbers
from graceful_plan.scene.mobile.diff_drive import DiffDrive


@dataclass(frozen=True, kw_only=True)
class PurePursuit:
    """Settings of pure pursuit.

    Args:
        seconds: Look-ahead time at the current speed [s].
        nearest: Least look-ahead distance [m].
        speed: Cruising speed, limited by the base [m/s].
        in_place: Angle off the heading above which the base first turns in place [rad].

    Raises:
        SettingError: If a number is out of its range.
    """

    seconds: float = 0.4
    nearest: float = 0.25
    speed: float = math.inf
    in_place: float = 1.2

    def __post_init__(self) -> None:
        plain_numbers(self)
        check_numbers(self, ("seconds", "nearest", "speed", "in_place"), above=True, finite=False)

    def command(self, state: DriveState, path: Float[Array, "n 2"], base: DiffDrive) -> DriveCommand:
        """Return the command that follows a path forwards and stops at its end.

        Args:
            state: State of the base.
            path: Points on the floor in W [m].
            base: Base with its limits. The command respects the speed limits but not the acceleration limits (see
                `limited`).

        Raises:
            ShapeError: If state or path are not of the right shape.
            NonFiniteError: If a number of them is not finite.
            SettingError: If a number of them is too large.
        """
        state, path = checked_state(state), checked_places(path)
        s, _ = foot(path, state)
        length = lengths(path)
        ahead = max(self.nearest, self.seconds * abs(state.v))
        x, y = at_length(path, s + ahead)
        distance = math.hypot(x - state.x, y - state.y)
        left = float(length[-1]) - s
        if left < 1e-3 or distance < 1e-6:
            return DriveCommand(0.0, 0.0)
        angle = wrapped(math.atan2(y - state.y, x - state.x) - state.yaw)
        if abs(angle) > self.in_place:
            return DriveCommand(
                0.0, math.copysign(min(base.omega_max, math.sqrt(2.0 * base.alpha_max * abs(angle))), angle)
            )
        curvature = 2.0 * math.sin(angle) / distance
        v = min(self.speed, base.v_max, math.sqrt(2.0 * base.a_max * left))
        if curvature:
            v = min(v, math.sqrt(base.lateral_max / abs(curvature)), base.omega_max / abs(curvature))
            v = min(v, base.rim_max / (1.0 + base.lever * abs(curvature)))
        return DriveCommand(v, v * curvature)


def lengths(path: Float[Array, "n 2"]) -> Float[Array, " n"]:
    """Return the length of a polyline up to each of its points [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1))])


def at_length(path: Float[Array, "n 2"], s: float) -> tuple[float, float]:
    """Return the point at a length along a polyline, clamped to its ends."""
    length = lengths(path)
    return float(np.interp(s, length, path[:, 0])), float(np.interp(s, length, path[:, 1]))


def foot(path: Float[Array, "n 2"], state: DriveState) -> tuple[float, float]:
    """Return the length along a polyline of the point nearest to a base, and its distance [m]."""
    p, begin = np.array([state.x, state.y]), path[:-1, :2]
    way = path[1:, :2] - begin
    squared = np.maximum((way**2).sum(axis=1), 1e-12)
    t = np.clip(((p - begin) * way).sum(axis=1) / squared, 0.0, 1.0)
    distance = np.linalg.norm(begin + t[:, None] * way - p, axis=1)
    if not len(distance):
        return 0.0, float(np.linalg.norm(path[0, :2] - p))
    k = int(distance.argmin())
    length = lengths(path)
    return float(length[k] + t[k] * (length[k + 1] - length[k])), float(distance[k])

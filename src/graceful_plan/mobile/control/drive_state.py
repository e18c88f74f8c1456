"""Inputs and outputs of base controllers: states, commands and surroundings."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array, is_real

FARTHEST = 1e4
"""Largest coordinate of a place [m], and largest angle [rad]."""
FASTEST = 1e3
"""Largest speed [m/s] and turning rate [rad/s]."""
MOST_PLACES = 100_000
"""Largest number of points of a path; controllers process all of them for every command."""


class DriveState(NamedTuple):
    """Pose and speeds of a base."""

    x: float
    """Position in W [m]."""
    y: float
    yaw: float
    """Heading [rad]."""
    v: float
    """Speed along the heading [m/s]."""
    omega: float
    """Turning rate [rad/s]."""


class DriveCommand(NamedTuple):
    """Commanded speeds of a base."""

    v: float
    """Speed along the heading [m/s]."""
    omega: float
    """Turning rate [rad/s]."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Planar shapes of static and moving objects around a base: rectangles, possibly rounded.

    | field    | meaning                                                                 | unit | shape   |
    |----------|-------------------------------------------------------------------------|------|---------|
    | shape    | centre, direction of the first side, half sizes, rounding radius        | m    | shape 7 |
    | entity   | entity index of each shape; -1 for obstacles, which have no severity    |      | shape   |
    | velocity | velocity in W; default: 0                                               | m/s  | shape 2 |
    | severity | severity of each entity, for a hit at the reference speed of severities |      | entity  |

    A cylinder has half sizes 0 and its radius as rounding radius.

    Raises:
        ShapeError: If the arrays do not fit together.
        NonFiniteError: If a number is NaN or infinite.
        SettingError: If a severity or a size is below 0, a direction is not of length 1, a number is too large, or a
            shape refers to an entity without severity.
    """

    shape: Float[Array, "shape 7"]
    entity: Int[Array, " shape"]
    velocity: Float[Array, "shape 2"]
    severity: Float[Array, " entity"]

    def __init__(
        self,
        shape: ArrayLike,
        entity: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        severity: ArrayLike | tuple[()] = (),
    ) -> None:
        rows = finite_array("shape", shape)
        rows = finite_array("shape", rows if rows.size else rows.reshape(0, 7), ndim=2, last=7)
        owner = np.full(len(rows), -1) if entity is None else finite_array("entity", entity, ndim=1)
        moves = np.zeros((len(rows), 2)) if velocity is None else finite_array("velocity", velocity)
        worth = (
            np.zeros(0) if isinstance(severity, tuple) and not severity else finite_array("severity", severity, ndim=1)
        )
        for name, given, expected in (("entity", owner, (len(rows),)), ("velocity", moves, (len(rows), 2))):
            if given.shape != expected:
                raise ShapeError(name, given.shape, f"{expected}, a row for each shape")
        if (rows[:, 4:] < 0.0).any() or (worth < 0.0).any():
            raise SettingError("shape", rows[:, 4:], "sizes and severities of at least 0")
        if len(owner) and not (-1 <= owner.min() and owner.max() < len(worth) and (owner == np.rint(owner)).all()):
            valid = f"whole numbers below {len(worth)}, the number of severities; -1 for none"
            raise SettingError("entity", float(owner.max()), valid)
        for name, given, most in (("shape", rows, FARTHEST), ("velocity", moves, FASTEST), ("severity", worth, 1e15)):
            if given.size and np.abs(given).max() > most:
                raise SettingError(name, float(np.abs(given).max()), f"numbers of at most {most:g}")
        if (np.abs(np.hypot(rows[:, 2], rows[:, 3]) - 1.0) > 1e-3).any():
            raise SettingError("shape", rows[:, 2:4], "directions of length 1: cosine and sine of an angle")
        for name, value in (
            ("shape", np.ascontiguousarray(rows)),
            ("entity", np.ascontiguousarray(owner, dtype=np.int32)),
            ("velocity", np.ascontiguousarray(moves, dtype=float)),
            ("severity", np.ascontiguousarray(worth)),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def discs(
        cls,
        centre: ArrayLike,
        radius: ArrayLike | float,
        *,
        velocity: ArrayLike | None = None,
        severity: ArrayLike | float | None = None,
    ) -> Surroundings:
        """Return surroundings of discs.

        Args:
            centre: Centre of each disc [m].
            radius: Radius of each disc [m].
            velocity: Velocity of each disc [m/s].
            severity: Severity of each disc that is an entity; 0 for obstacles.
        """
        places = np.atleast_2d(finite_array("centre", centre))
        places = finite_array("centre", places if places.size else places.reshape(0, 2), ndim=2, last=2)
        n = len(places)
        rows = np.column_stack([places, np.ones(n), np.zeros((n, 3)), _for_each("radius", radius, n)])
        if severity is None:
            return cls(rows, velocity=velocity)
        worth = _for_each("severity", severity, n)
        entity = np.where(worth > 0.0, np.cumsum(worth > 0.0) - 1, -1)
        return cls(rows, entity, velocity, worth[worth > 0.0])


def check_numbers(settings: object, names: Iterable[str], *, above: bool = False, finite: bool = True) -> None:
    """Raise SettingError unless all of these settings are numbers of at least 0.

    Args:
        settings: Settings object of a controller.
        names: Names of the fields to check.
        above: Whether 0 is excluded.
        finite: Whether infinity is excluded.
    """
    for name in names:
        value = getattr(settings, name)
        large = is_real(value) and (value > 0.0 or (value == 0.0 and not above))
        if not large or (finite and not math.isfinite(value)):
            words = f"a {'finite ' if finite else ''}number {'above' if above else 'of at least'} 0"
            raise SettingError(f"{type(settings).__name__}.{name}", value, words)


def wrapped(angle: float) -> float:
    """Wrap an angle to [-pi, pi)."""
    return math.remainder(angle, 2.0 * math.pi)


def checked_state(state: DriveState) -> DriveState:
    """Validate a state for the controllers.

    Raises:
        ShapeError: If it is not five numbers.
        NonFiniteError: If a number is not finite: stop a base whose state is unknown.
        SettingError: If a number is too large.
    """
    row = finite_array("state", list(state), ndim=1, last=5)
    if np.abs(row[:3]).max() > FARTHEST or np.abs(row[3:]).max() > FASTEST:
        raise SettingError("state", row.tolist(), f"places and angles up to {FARTHEST:g}, speeds up to {FASTEST:g}")
    return DriveState(*row.tolist())


def checked_places(path: ArrayLike) -> Float[Array, "n 2"]:
    """Return the first two columns of a path on the floor after validating it.

    Raises:
        ShapeError: If it does not have 1 to `MOST_PLACES` rows of at least two columns.
        NonFiniteError: If a number is not finite.
        SettingError: If a place is too far away.
    """
    places = finite_array("path", path)
    if places.ndim != 2 or places.shape[1] < 2 or not 1 <= len(places) <= MOST_PLACES:
        raise ShapeError("path", places.shape, f"(1 to {MOST_PLACES}, 2)")
    places = np.ascontiguousarray(places[:, :2])
    if np.abs(places).max() > FARTHEST:
        raise SettingError("path", float(np.abs(places).max()), f"places up to {FARTHEST:g} m")
    return places


def _for_each(name: str, value: ArrayLike | float, n: int) -> Float[Array, " n"]:
    given = finite_array(name, [value] * n if is_real(value) else value)  # type: ignore[arg-type]
    if given.shape != (n,):
        raise ShapeError(name, given.shape, f"() or ({n},)")
    return given

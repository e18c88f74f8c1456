"""What controllers of a base see and say."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float, Int
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array

Array = np.ndarray


class DriveState(NamedTuple):
    """Where a base is and how fast it drives."""

    x: float
    """In W [m]."""
    y: float
    yaw: float
    """Heading [rad]."""
    v: float
    """Along the heading [m/s]."""
    omega: float
    """Rate of turning [rad/s]."""


class DriveCommand(NamedTuple):
    """How fast a base is to drive."""

    v: float
    """Along the heading [m/s]."""
    omega: float
    """Rate of turning [rad/s]."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What stands or moves around a base, from above: rectangles that may be rounded.

    | field    | meaning                                                                              | unit | shape   |
    |----------|--------------------------------------------------------------------------------------|------|---------|
    | shape    | centre, direction of the first side, half sizes, and by how much it is rounded       | m    | shape 7 |
    | entity   | which entity it is of; -1 for obstacles, which nobody harms                          |      | shape   |
    | velocity | how fast it moves in W; not at all by default                                        | m/s  | shape 2 |
    | severity | of each entity, if the base hits it at the speed that severities are for             |      | entity  |

    A cylinder has half sizes 0 and its radius as rounding.

    Raises:
        ShapeError: If the arrays do not fit together.
        NonFiniteError: If a number is NaN or infinite.
        SettingError: If a severity or a size is below 0, or a shape is of an entity that has no severity.
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
        rows = finite_array("shape", np.asarray(shape, dtype=float).reshape(-1, 7), ndim=2)
        owner = np.full(len(rows), -1) if entity is None else np.asarray(entity)
        moves = np.zeros((len(rows), 2)) if velocity is None else finite_array("velocity", velocity, ndim=2)
        worth = finite_array("severity", np.asarray(severity, dtype=float), ndim=1)
        for name, given, expected in (("entity", owner, (len(rows),)), ("velocity", moves, (len(rows), 2))):
            if given.shape != expected:
                raise ShapeError(name, given.shape, f"{expected}, a row for each shape")
        if (rows[:, 4:] < 0.0).any() or (worth < 0.0).any():
            raise SettingError("shape", rows[:, 4:], "sizes and severities of at least 0")
        if len(owner) and not (-1 <= owner.min() and owner.max() < len(worth)):
            raise SettingError("entity", int(owner.max()), f"below {len(worth)}, the number of severities; -1 for none")
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
            centre: Of each [m].
            radius: Of each [m].
            velocity: Of each [m/s].
            severity: Of each, if they are entities; 0 for what is none.
        """
        places = np.asarray(centre, dtype=float).reshape(-1, 2)
        n = len(places)
        rows = np.column_stack([places, np.ones(n), np.zeros((n, 3)), np.broadcast_to(radius, (n,))])
        if severity is None:
            return cls(rows, velocity=velocity)
        worth = np.broadcast_to(np.asarray(severity, dtype=float), (n,))
        entity = np.where(worth > 0.0, np.cumsum(worth > 0.0) - 1, -1)
        return cls(rows, entity, velocity, worth[worth > 0.0])


def check_numbers(settings: object, names: Iterable[str], *, above: bool = False, finite: bool = True) -> None:
    """Raise SettingError unless all of these settings are numbers of at least 0.

    Args:
        settings: A settings object of a controller.
        names: Of its fields.
        above: Whether 0 is none of them.
        finite: Whether infinity is none of them.
    """
    for name in names:
        value = getattr(settings, name)
        if not (value > 0.0 or (value == 0.0 and not above)) or (finite and not math.isfinite(value)):
            words = f"a {'finite ' if finite else ''}number {'above' if above else 'of at least'} 0"
            raise SettingError(f"{type(settings).__name__}.{name}", value, words)


def wrapped(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return math.remainder(angle, 2.0 * math.pi)

"""Moving entities: people, animals or objects that can be harmed, with a predicted path over time.

Planners weigh harm to them, but they are not obstacles: nothing checks for collisions with them. The models of harm
are in `costs/models/moving/drops.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SceneError, SettingError, ShapeError
from graceful_plan.path import finite_array, plain_numbers
from graceful_plan.scene.loading.naming import is_name
from graceful_plan.scene.screening import MAX_EXTENT
from graceful_plan.setting_checks import not_negative


class PredictedPose(NamedTuple):
    """Predicted poses of a moving entity at given times."""

    position: Float[Array, "*batch 3"]
    """Centre of the entity in W [m]."""
    yaw: Float[Array, " *batch"]
    """Rotation about the vertical [rad]."""
    spread: Float[Array, " *batch"]
    """Standard deviation of the position along x and along y [m]."""


@dataclass(frozen=True, eq=False, init=False)
class MovingEntity:
    """An upright box or cylinder that can be harmed, with a predicted path over time.

    It moves at constant velocity between the given positions and rests before the first and after the last time. Times
    are on the clock of the evaluated trajectories: t = 0 is the start of the trajectory that `plan` returns.

    Args:
        name: Name of the entity; must differ from all entities and bodies of the scene.
        category: Class of the entity in the severity table, e.g. "adult" or "pet".
        size: Three half sizes of a box, or radius and half height of a cylinder [m].
        t: Times of the prediction [s], increasing.
        position: Centre in W at these times [m].
        yaw: Rotation of a box about the vertical at these times [rad], interpolated along the shorter direction; 0 by
            default.
        spread: Standard deviation of the position, along x and along y, up to the first time [m].
        growth: Standard deviation of the velocity [m/s]: after the first time, `(growth (t - t[0]))^2` adds to the
            variance of the position, also after the last time.
        severity: Severities that replace the table's: one number for all components, or numbers by component.

    Raises:
        ShapeError: If the shapes of the arrays do not match.
        NonFiniteError: If a number is NaN or infinite.
        SettingError: If times do not increase, a size is not above 0 or a spread or growth is below 0.
        SceneError: If the name is empty.
    """

    name: str
    category: str
    size: Float[Array, " size"]
    t: Float[Array, " k"]
    position: Float[Array, "k 3"]
    yaw: Float[Array, " k"]
    spread: float
    growth: float
    severity: float | Mapping[str, float] | None

    def __init__(
        self,
        name: str,
        category: str,
        *,
        size: ArrayLike,
        t: ArrayLike,
        position: ArrayLike,
        yaw: ArrayLike | None = None,
        spread: float = 0.0,
        growth: float = 0.0,
        severity: float | Mapping[str, float] | None = None,
    ) -> None:
        if not is_name(name):
            raise SceneError(f"a moving entity needs a name, not {name!r}")
        times, places = finite_array(f"t of {name}", t, ndim=1), finite_array(f"position of {name}", position, ndim=2)
        if np.abs(places).max(initial=0.0) > MAX_EXTENT:
            raise SettingError(f"position of {name}", float(np.abs(places).max()), f"places within {MAX_EXTENT:g} m")
        turns = np.zeros(len(times)) if yaw is None else finite_array(f"yaw of {name}", yaw, ndim=1)
        for what, given, shape in (("position", places, (len(times), 3)), ("yaw", turns, (len(times),))):
            if given.shape != shape:
                raise ShapeError(f"{what} of {name}", given.shape, f"{shape}, one row for each time")
        _check_times(name, times)
        for what, value in (("spread", spread), ("growth", growth)):
            not_negative(f"{what} of {name}", value)
        values = {
            "name": name,
            "category": category,
            "size": _frozen(_checked_size(name, size)),
            "t": _frozen(times),
            "position": _frozen(places),
            "yaw": _frozen(np.unwrap(turns)),
            "spread": float(spread),
            "growth": float(growth),
            "severity": severity,
        }
        for field, value in values.items():
            object.__setattr__(self, field, value)
        plain_numbers(self)

    @property
    def is_round(self) -> bool:
        """Whether the entity is a cylinder."""
        return len(self.size) == 2

    @property
    def half_size(self) -> Float[Array, " 3"]:
        """Half sizes of the upright bounding box [m]."""
        return self.size[[0, 0, 1]] if self.is_round else self.size

    @property
    def lowest(self) -> float:
        """Height of the bottom at the lowest point of the path [m]."""
        return float(self.position[:, 2].min() - self.half_size[2])

    @property
    def top_speed(self) -> float:
        """Largest speed along the path [m/s]."""
        steps = np.linalg.norm(np.diff(self.position, axis=0), axis=1)
        return float(np.max(steps / np.diff(self.t), initial=0.0))

    def at(self, t: ArrayLike | float) -> PredictedPose:
        """Return the predicted poses at one or more times [s]."""
        times = finite_array("t", np.asarray(t))
        position = np.stack([np.interp(times, self.t, axis) for axis in self.position.T], axis=-1)
        known_for = np.maximum(times - self.t[0], 0.0)
        spread = np.hypot(self.spread, self.growth * known_for)
        return PredictedPose(position, np.asarray(np.interp(times, self.t, self.yaw)), np.asarray(spread))

    def later(self, seconds: float) -> MovingEntity:
        """Return the same prediction shifted in time by `seconds`; a negative number shifts it to earlier times.

        Use it for predictions on another clock, for example with t = 0 some time before the robot starts.
        """
        return MovingEntity(
            self.name,
            self.category,
            size=self.size,
            t=self.t + finite_array("seconds", np.asarray(seconds), ndim=0),
            position=self.position,
            yaw=self.yaw,
            spread=self.spread,
            growth=self.growth,
            severity=self.severity,
        )


def _checked_size(name: str, size: ArrayLike) -> Float[Array, " size"]:
    array = finite_array(f"size of {name}", size, ndim=1)
    if len(array) not in (2, 3):
        raise ShapeError(f"size of {name}", array.shape, "(3,) for a box or (2,) for a cylinder")
    if (array <= 0.0).any() or (array > MAX_EXTENT).any():
        raise SettingError(f"size of {name}", array.tolist(), f"lengths above 0, of at most {MAX_EXTENT:g} m")
    return array


def _check_times(name: str, t: Float[Array, " k"]) -> None:
    if not len(t):
        raise ShapeError(f"t of {name}", t.shape, "(k >= 1,)")
    backwards = np.flatnonzero(np.diff(t) <= 0.0)
    if len(backwards):
        i = int(backwards[0]) + 1
        raise SettingError(f"t[{i}] of {name}", float(t[i]), f"more than t[{i - 1}] = {t[i - 1]}: time must increase")


def _frozen(array: Array) -> Array:
    array = np.array(array)
    array.flags.writeable = False
    return array

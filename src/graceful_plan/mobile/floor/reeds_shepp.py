"""Shortest curves of a steered base without obstacles: forward and backward, forward only, or with turns in place.

[ReedsShepp1990] J. A. Reeds, L. A. Shepp, "Optimal paths for a car that goes both forwards and backwards", Pacific
Journal of Mathematics 145. [Dubins1957] L. E. Dubins, "On curves of minimal length with a constraint on average
curvature", American Journal of Mathematics 79. A pose is (x, y, yaw) [m, m, rad].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array
from graceful_plan.setting_checks import positive


@dataclass(frozen=True, kw_only=True)
class Steering:
    """Steering limits of a base, and costs of its moves in metres.

    With `yaw_length`, a curve is the cheapest among those of a car and (turn, straight, turn). Without it, a curve is
    the cheapest of [ReedsShepp1990], or of [Dubins1957] if the base may not drive backwards.

    Raises:
        SettingError: If a number is out of its range.
    """

    radius: float
    """Radius of the tightest curve [m], > 0."""
    reverse: bool = True
    """Whether the base may drive backwards."""
    yaw_length: float | None = None
    """Cost of turning in place [m/rad], > 0; None: the base does not turn in place."""
    reverse_penalty: float = 1.0
    """Cost of driving backwards [m/m], >= 1."""

    def __post_init__(self) -> None:
        yaw_length = 1.0 if self.yaw_length is None else self.yaw_length
        for name, value in (("radius", self.radius), ("yaw_length", yaw_length)):
            positive(f"Steering.{name}", value)
        if not (math.isfinite(self.reverse_penalty) and self.reverse_penalty >= 1.0):
            raise SettingError("Steering.reverse_penalty", self.reverse_penalty, "a finite number >= 1")

    def native(self) -> _native.Steering:
        """Return the steering object of the core."""
        return _native.Steering(
            radius=self.radius,
            reverse=self.reverse,
            yaw_length=math.inf if self.yaw_length is None else self.yaw_length,
            penalty=self.reverse_penalty,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Curves:
    """Curves that start at poses, each made of pieces with a constant steering angle.

    A piece is (length [m], negative backwards; curvature [1/m], positive to the left; turn in place [rad], whose length
    is 0). Unused pieces are 0.
    """

    steering: Steering
    start: Float[Array, "*batch xyyaw"]
    pieces: Float[Array, "*batch piece 3"]

    @property
    def measure(self) -> Float[Array, "*batch piece"]:
        """Measure of each piece [m]: metres driven, plus `yaw_length` for each radian turned in place."""
        length, turn = np.abs(self.pieces[..., 0]), np.abs(self.pieces[..., 2])
        return length + (self.steering.yaw_length or 0.0) * turn

    @property
    def cost(self) -> Float[Array, "*batch"]:
        """Cost of each curve [m]: its measure, with the penalty for driving backwards."""
        backwards = np.maximum(-self.pieces[..., 0], 0.0)
        return np.asarray((self.measure + (self.steering.reverse_penalty - 1.0) * backwards).sum(axis=-1))

    def at(self, s: ArrayLike) -> Float[Array, "*batch n xyyaw"]:
        """Return the poses at measures s [m] from the starts; yaw is continuous beyond pi.

        Args:
            s: Measures, equally many for each curve; values beyond an end give the end.
        """
        batch, s = self.start.shape[:-1], np.asarray(s, dtype=float)
        wanted = np.broadcast_to(s, (*batch, s.shape[-1]))
        n = math.prod(batch)
        found = self.steering.native().along(
            np.ascontiguousarray(self.start.reshape(n, 3)),
            np.ascontiguousarray(self.pieces.reshape(n, -1, 3)),
            np.ascontiguousarray(wanted.reshape(n, -1)),
        )
        return found.reshape(*batch, -1, 3)

    def sampled(self, spacing: float) -> Float[Array, "n xyyaw"]:
        """Sample poses along one curve, at the ends of its pieces and at most `spacing` [m] of measure apart."""
        if self.start.ndim != 1:
            raise ShapeError("start", self.start.shape, "(3,): one curve, see `at` for several")
        if not spacing > 0.0:
            raise SettingError("spacing", spacing, "a number > 0")
        s, end = [np.zeros(1)], 0.0
        for length in self.measure[self.measure > 0.0]:
            s.append(end + length * np.linspace(0.0, 1.0, math.ceil(length / spacing) + 1)[1:])
            end += length
        return self.at(np.concatenate(s))


def shortest_curves(start: ArrayLike, goal: ArrayLike, steering: Steering) -> Curves:
    """Find the cheapest curves between poses, without obstacles.

    Args:
        start: Poses (x, y, yaw) [m, m, rad].
        goal: Goal poses, likewise; batch axes of both are broadcast.
        steering: Steering limits and costs of the base.

    Raises:
        ShapeError: If the last axis of poses is not 3.
        NonFiniteError: If a pose is not finite.
    """
    a, b = finite_array("start", start), finite_array("goal", goal)
    for name, poses in (("start", a), ("goal", b)):
        if poses.ndim == 0 or poses.shape[-1] != 3:
            raise ShapeError(name, poses.shape, "(..., 3)")
    a, b = (np.ascontiguousarray(poses) for poses in np.broadcast_arrays(a, b))
    _, pieces = steering.native().curves(a.reshape(-1, 3), b.reshape(-1, 3))
    return Curves(steering=steering, start=a, pieces=pieces.reshape(*a.shape[:-1], 5, 3))

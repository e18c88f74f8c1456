"""Smooth curves: clamped cubic B-splines with continuous curvature, inside the hull of their control points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.timing.blend import CurveGrid, places

if TYPE_CHECKING:
    from typing import Self


_INTERVALS = 128
"""Intervals in the coarsest grid."""


@dataclass(frozen=True, eq=False)
class Spline:
    """A clamped cubic B-spline: it begins at its first control point and ends at its last.

    Args:
        controls: Control points, at least four [rad or m]; knots are uniform.
    """

    controls: Float[Array, "control nq"]

    @classmethod
    def through(cls, points: Float[Array, "point nq"]) -> Self:
        """Interpolate points, at least four, at uniform knots.

        The first two and the last two spans are one cubic each (de Boor's not-a-knot condition), because the
        derivatives at the ends are unknown.
        """
        none = np.zeros((2, points.shape[1]))
        return cls(_collocation(len(points)) @ np.concatenate([points, none]))

    @property
    def spans(self) -> int:
        """Number of intervals between knots; the parameter runs from 0 to this number."""
        return len(self.controls) - 3

    def at(self, u: Float[Array, " n"]) -> Float[Array, "n nq"]:
        """Evaluate the curve at parameters."""
        return _native.spline(np.ascontiguousarray(self.controls, dtype=np.float64), u)[0]

    @property
    def samples(self) -> Float[Array, "n nq"]:
        """Configurations on the curve at the parameters of the coarsest grid."""
        return self.at(self._parameters(1))

    def even(self, n: int) -> Float[Array, "n nq"]:
        """Return `n` configurations at uniform parameters, including both ends."""
        q = self.at(np.linspace(0.0, self.spans, n))
        q[0], q[-1] = self.controls[0], self.controls[-1]  # exact
        return q

    def with_controls(self, n: int) -> Spline:
        """Return the curve with `n` control points: unchanged if it has `n`, else an interpolant at the new knots."""
        if len(self.controls) == n:
            return self
        fitted = Spline.through(self.at(np.linspace(0.0, self.spans, n - 2))).controls.copy()
        fitted[0], fitted[-1] = self.controls[0], self.controls[-1]
        return Spline(fitted)

    def _parameters(self, density: int) -> Float[Array, " n"]:
        u = places(density * _intervals(self.spans), from_rest=True, to_rest=True) * self.spans
        u[-1] = self.spans
        return u

    def grid(self, density: int) -> CurveGrid:
        """Sample the curve for timing; see `Curve`."""
        u = self._parameters(density)
        q, slope, bend = _native.spline(np.ascontiguousarray(self.controls, dtype=np.float64), u)
        stop = np.zeros(len(u), dtype=bool)
        stop[[0, -1]] = True
        both = np.stack([slope[:-1], slope[1:]], axis=1), np.stack([bend[:-1], bend[1:]], axis=1)
        q[0], q[-1] = self.controls[0], self.controls[-1]
        return CurveGrid(u, q, *both, stop)


def grid_points(controls: int) -> int:
    """Return the number of samples in the coarsest grid of a curve with this number of control points."""
    return len(places(_intervals(controls - 3), from_rest=True, to_rest=True))


def _intervals(spans: int) -> int:
    return max(_INTERVALS, 4 * spans)


@lru_cache(maxsize=16)
def _collocation(points: int) -> Float[Array, "control control"]:
    """Return the matrix from points at the knots, followed by two zero rows for the ends, to control points."""
    value, _, bend = _native.spline(np.eye(points + 2), np.arange(points, dtype=np.float64))
    # The third derivative is constant on a span; two spans form one cubic if the second one is linear over both.
    ends = np.stack([bend[0] - 2.0 * bend[1] + bend[2], bend[-1] - 2.0 * bend[-2] + bend[-3]])
    return np.linalg.inv(np.concatenate([value, ends]))

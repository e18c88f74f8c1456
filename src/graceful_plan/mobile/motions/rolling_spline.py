"""Smooth curves that a base rolls along: its heading follows the tangent, or the opposite direction in reverse.

The splines are cubic, so curvature and turning rate are continuous.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.timing.blend import CurveGrid, places
from graceful_plan.timing.spline import Spline

_INTERVALS, _BY_METRE = 128, 25.0
"""Least number of intervals of the coarsest grid, and least number per length [1/m]. With such a grid, the sideways
speed between its points stays below 0.2 mm/s at 2 m/s."""
_LEAST_SQUARED = 1e-12
"""Squared length of a tangent below which a curve has no direction."""


@dataclass(frozen=True, eq=False)
class RollingSpline:
    """A clamped cubic B-spline of a base and its arm.

    | field    | meaning                                                                                            |
    |----------|----------------------------------------------------------------------------------------------------|
    | controls | x and y of the base [m], joints of the arm [rad or m], logarithm of the share of the fastest speed |
    | forward  | whether the heading is that of the tangent, or the opposite                                        |
    | before   | heading of the base at the start, whole turns included [rad]                                       |
    """

    controls: Float[Array, "control column"]
    forward: bool
    before: float

    @property
    def spans(self) -> int:
        """Number of knot intervals; the parameter ranges from 0 to it."""
        return len(self.controls) - 3

    @property
    def samples(self) -> Float[Array, "n nq"]:
        """Configurations at the parameters of the coarsest grid."""
        return self._at(self._parameters(1))[0]

    def even(self, n: int) -> Float[Array, "n nq"]:
        """Return configurations at evenly spaced parameters, including both ends."""
        return self._at(np.linspace(0.0, self.spans, n))[0]

    def with_controls(self, n: int) -> RollingSpline:
        """Return the same curve, or one close to it, with `n` control points."""
        return replace(self, controls=Spline(self.controls).with_controls(n).controls)

    def share(self, u: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return the share of the fastest speed at parameters."""
        return np.exp(_native.spline(np.ascontiguousarray(self.controls), u)[0][:, -1])

    def grid(self, density: int) -> CurveGrid:
        """Sample the curve for timing; see `Curve`."""
        u = self._parameters(density)
        q, slope, bend, third = self._at(u)
        both = np.stack([bend[:-1], bend[1:]], axis=1)
        both[:, :, 2] += third
        stop = np.zeros(len(u), dtype=bool)
        stop[[0, -1]] = True
        return CurveGrid(u, q, np.stack([slope[:-1], slope[1:]], axis=1), both, stop)

    def _parameters(self, density: int) -> Float[Array, " n"]:
        """Return parameters that include all knots, where the third derivative jumps."""
        length = float(np.linalg.norm(np.diff(self.controls[:, :2], axis=0), axis=1).sum())
        each = int(np.ceil(max(_INTERVALS, _BY_METRE * length) / self.spans))
        u = places(density * each * self.spans, from_rest=True, to_rest=True) * self.spans
        u[-1] = self.spans
        return u

    def _at(
        self, u: Float[Array, " n"]
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"], Float[Array, "n nq"], Float[Array, "interval 2"]]:
        """Return configurations, first and second derivatives, and a correction of the heading's second derivative.

        The heading's second derivative is the sum of its entry in the third array and the correction, which is given at
        both ends of each interval because the third derivative of the spline jumps at knots.
        """
        value, slope, bend = (part[:, :-1] for part in _native.spline(np.ascontiguousarray(self.controls), u))
        v, a = slope[:, :2], bend[:, :2]
        squared = np.maximum((v * v).sum(axis=1), _LEAST_SQUARED)
        turn = _cross(v, a) / squared
        sign = 1.0 if self.forward else -1.0
        heading = np.unwrap(np.concatenate([[self.before], np.arctan2(sign * v[:, 1], sign * v[:, 0])]))[1:]
        swing = -2.0 * turn * (v * a).sum(axis=1) / squared
        rows = [np.insert(part, 2, column, axis=1) for part, column in ((value, heading), (slope, turn), (bend, swing))]
        jerk = np.diff(a, axis=0) / np.diff(u)[:, None]
        third = np.stack([_cross(v[:-1], jerk) / squared[:-1], _cross(v[1:], jerk) / squared[1:]], axis=1)
        return rows[0], rows[1], rows[2], third


@dataclass(frozen=True, eq=False)
class RollingCurves:
    """Curves of a base between two headings; a kind of curve for descents.

    | field        | meaning                                        | unit |
    |--------------|------------------------------------------------|------|
    | base         | drive parameters of the base                   |      |
    | before       | heading of the base at the start               | rad  |
    | after        | heading at the end                             | rad  |
    | forward      | whether it drives forward                      |      |
    | turns_before | whether the base may turn in place first       |      |
    | turns_after  | whether it may turn in place at the end        |      |
    | holds_arm    | whether the arm keeps its posture of the start |      |
    | speed        | fraction of the speed limits to use            |      |
    """

    base: DiffDrive
    before: float
    after: float
    forward: bool = True
    turns_before: bool = False
    turns_after: bool = False
    holds_arm: bool = False
    speed: float = 1.0
    rolling: _native.Rolling = field(init=False)
    """These settings in the core."""

    def __post_init__(self) -> None:
        base, share = self.base, self.speed
        rolling = _native.Rolling(
            speed=share * base.v_max,
            turning=share * base.omega_max,
            acceleration=share**2 * base.a_max,
            turning_acceleration=share**2 * base.alpha_max,
            across=share**2 * base.lateral_max,
            rim=share * base.rim_max,
            lever=base.lever,
            forward=self.forward,
            before=self.before,
            after=self.after,
            turns_before=self.turns_before,
            turns_after=self.turns_after,
            holds_arm=self.holds_arm,
        )
        object.__setattr__(self, "rolling", rolling)

    def curve(self, controls: Float[Array, "control column"]) -> RollingSpline:
        """See `CurveKind`."""
        return RollingSpline(controls, self.forward, self.before)


def _cross(a: Float[Array, "n 2"], b: Float[Array, "n 2"]) -> Float[Array, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

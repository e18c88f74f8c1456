"""Smooth curves: clamped cubic B-splines, with continuous curvature and within the hull of their control points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.timing.blend import CurveGrid, places

Array = np.ndarray

_INTERVALS = 128
"""Of the coarsest grid."""


@dataclass(frozen=True, eq=False)
class Spline:
    """A curve through configurations that begins at its first control point and ends at its last.

    Args:
        controls: Control points, at least four [rad or m]; knots are even.
    """

    controls: Float[Array, "control nq"]

    def grid(self, density: int) -> CurveGrid:
        """Sample it for timing; see `Curve`."""
        spans = len(self.controls) - 3
        n = density * max(_INTERVALS, 4 * spans)
        u = places(n, from_rest=True, to_rest=True) * spans
        u[-1] = spans
        q, slope, bend = _native.spline(np.ascontiguousarray(self.controls, dtype=np.float64), u)
        stop = np.zeros(len(u), dtype=bool)
        stop[[0, -1]] = True
        both = np.stack([slope[:-1], slope[1:]], axis=1), np.stack([bend[:-1], bend[1:]], axis=1)
        q[0], q[-1] = self.controls[0], self.controls[-1]
        return CurveGrid(u, q, *both, stop)

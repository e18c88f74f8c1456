"""Curves of a whole motion of a base with an arm: rolling curves, turns in place, and arm motions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.mobile.motions.rolling_spline import RollingSpline
from graceful_plan.timing.blend import CurveGrid, places

_SAME = 1e-9
"""Largest difference between two equal configurations [rad or m]."""
_INTERVALS = 16
"""Number of intervals of a move's coarsest grid."""
_FULL = 0.98
"""Share of the fastest speed above which a curve counts as driven at full speed."""


@dataclass(frozen=True, eq=False)
class StraightMove:
    """A turn in place or an arm motion, straight in joint space.

    Args:
        begin: First configuration [rad or m].
        end: Last configuration [rad or m].
    """

    begin: Float[Array, " nq"]
    end: Float[Array, " nq"]

    def grid(self, density: int) -> CurveGrid:
        """Sample the move for timing; see `Curve`."""
        u = places(_INTERVALS * density, from_rest=True, to_rest=True)
        way = self.end - self.begin
        q = self.begin + u[:, None] * way
        q[-1] = self.end
        stop = np.zeros(len(u), dtype=bool)
        stop[[0, -1]] = True
        slope = np.broadcast_to(way, (len(u) - 1, 2, len(way)))
        return CurveGrid(u, q, slope, np.zeros_like(slope), stop)


@dataclass(frozen=True, eq=False)
class Drive:
    """A sequence of curves, with a rest at the end of each.

    Args:
        parts: At least one curve; each begins where the previous one ends.
    """

    parts: tuple[RollingSpline | StraightMove, ...]

    def grid(self, density: int) -> CurveGrid:
        """Sample the drive for timing; see `Curve`."""
        grids = [part.grid(density) for part in self.parts]
        begins = np.cumsum([0.0, *(grid.s[-1] for grid in grids)])
        s = [grid.s[1:] + begin for grid, begin in zip(grids, begins, strict=False)]
        return CurveGrid(
            np.concatenate([[0.0], *s]),
            np.concatenate([*(grid.q[:-1] for grid in grids), grids[-1].q[-1:]]),
            np.concatenate([grid.slope for grid in grids]),
            np.concatenate([grid.bend for grid in grids]),
            np.concatenate([[True], *(grid.stop[1:] for grid in grids)]),
        )

    def share(self, grid: CurveGrid) -> Float[Array, " point"] | None:
        """Return the share of the fastest speed at the points of a grid; None if it is full speed everywhere."""
        share, begin = np.ones(len(grid.s)), 0.0
        for part in self.parts:
            if isinstance(part, RollingSpline):
                inside = (grid.s >= begin) & (grid.s <= begin + part.spans)
                share[inside] = np.minimum(share[inside], part.share(np.clip(grid.s[inside] - begin, 0.0, part.spans)))
                begin += part.spans
            else:
                begin += 1.0
        return None if share.min() > _FULL else share


def joined(
    start: Float[Array, " nq"], curves: Sequence[RollingSpline | Float[Array, "2 nq"]], end: Float[Array, " nq"]
) -> Drive:
    """Concatenate curves and arm motions, with turns in place where headings differ.

    Args:
        start: First configuration [rad or m].
        curves: Curves, and arm motions as pairs of configurations, whose headings are ignored.
        end: Last configuration; its heading may be off by whole turns.
    """
    parts: list[RollingSpline | StraightMove] = []
    heading = start[2]
    for curve in curves:
        if isinstance(curve, RollingSpline):
            first = curve.even(2)[0]
            parts += _turn(first, heading, nearest(first[2], heading))
            rolled = RollingSpline(curve.controls, curve.forward, nearest(first[2], heading))
            parts.append(rolled)
            heading = rolled.samples[-1, 2]
        elif np.abs(curve[1] - curve[0])[[0, 1, *range(3, curve.shape[1])]].max() > _SAME:
            parts.append(StraightMove(with_heading(curve[0], heading), with_heading(curve[1], heading)))
    parts += _turn(end, heading, nearest(end[2], heading))
    return Drive(tuple(parts))


def with_heading(q: Float[Array, " nq"], heading: float) -> Float[Array, " nq"]:
    """Return a configuration with another heading."""
    turned = q.copy()
    turned[2] = heading
    return turned


def nearest(heading: float, to: float) -> float:
    """Return the heading shifted by whole turns so that it is nearest to `to` [rad]."""
    return float(to + np.remainder(heading - to + np.pi, 2.0 * np.pi) - np.pi)


def _turn(q: Float[Array, " nq"], a: float, b: float) -> Iterable[StraightMove]:
    return [StraightMove(with_heading(q, a), with_heading(q, b))] if abs(b - a) > _SAME else []

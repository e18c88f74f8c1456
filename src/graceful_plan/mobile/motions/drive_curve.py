"""What a base that rolls along its heading travels: smooth curves of the plane, turns in place, moves of the arm.

On a curve the heading is that of the tangent, or of its opposite in reverse, so that nothing moves sideways; where the
curve has a continuous third derivative, the rate of turning can follow. Between two stretches the robot rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.timing.blend import CurveGrid, places
from graceful_plan.timing.bspline import DEGREE, basis

Array = np.ndarray

_LEAST_INTERVALS, _BY_SPAN, _BY_METRE = 48, 6, 25.0
"""Of the coarsest grid of a roll: in all, for each span of its spline, and by length [1/m]. Between them, what moves
sideways at 2 m/s is then below 0.2 mm/s."""
_KEPT = 0.99
"""Share of the acceleration along the heading that is used: between two points of a grid it is up to 1 % more."""
_STRAIGHT_INTERVALS = 16
"""Of the coarsest grid of a stretch that is straight in joint space."""


@runtime_checkable
class Stretch(Protocol):
    """A part of a drive between two rests."""

    def samples(self, density: int) -> tuple[Float[Array, " u"], Float[Array, "3 u nq"]]:
        """Return parameters from 0, and configurations there with their first and second derivatives."""
        ...


@dataclass(frozen=True, eq=False)
class Straight:
    """A turn in place, or the arm moving: straight in joint space.

    Args:
        begin: First configuration [rad or m].
        end: Last one.
    """

    begin: Float[Array, " nq"]
    end: Float[Array, " nq"]

    def samples(self, density: int) -> tuple[Float[Array, " u"], Float[Array, "3 u nq"]]:
        """See `Stretch`."""
        u = places(_STRAIGHT_INTERVALS * density, from_rest=True, to_rest=True)
        way = self.end - self.begin
        q = self.begin + u[:, None] * way
        q[-1] = self.end
        return u, np.stack([q, np.broadcast_to(way, q.shape), np.zeros_like(q)])


@dataclass(frozen=True, eq=False)
class Roll:
    """A smooth curve of the base in one gear.

    Args:
        controls: Control points of a clamped quintic B-spline, at least `DEGREE` + 1: in the plane [m], and of the arm
            [rad or m]; with x and y alone the arm stays as it is at the beginning.
        begin: First configuration [rad or m]; x, y and arm are those of the first control point.
        end: Last configuration.
        forward: Whether the heading is that of the tangent, or the opposite.
    """

    controls: Float[Array, "control axis"]
    begin: Float[Array, " nq"]
    end: Float[Array, " nq"]
    forward: bool

    def samples(self, density: int) -> tuple[Float[Array, " u"], Float[Array, "3 u nq"]]:
        """See `Stretch`."""
        length = np.linalg.norm(np.diff(self.controls[:, :2], axis=0), axis=1).sum()
        spans = len(self.controls) - DEGREE
        intervals = density * max(_LEAST_INTERVALS, _BY_SPAN * spans, int(np.ceil(_BY_METRE * length)))
        u = places(intervals, from_rest=True, to_rest=True)
        found = self.at(u)
        found[0, 0], found[0, -1] = self.begin, self.end
        return u, found

    def at(self, u: Float[Array, " u"]) -> Float[Array, "3 u nq"]:
        """Return configurations at parameters from 0 to 1, with their first and second derivatives."""
        P = basis(len(self.controls), tuple(u.tolist())) @ self.controls
        flat = rolled(P[..., :2], self.forward)
        found = np.zeros((3, len(u), len(self.begin)))
        found[0] = self.begin
        found[:, :, :3] = flat
        if P.shape[-1] > 2:
            found[:, :, 3:] = P[:3, :, 2:]
        # The heading goes on from that of the beginning, whole turns included.
        heading = np.unwrap(np.concatenate([self.begin[2:3], flat[0, :, 2]]))
        found[0, :, 2] = heading[1:]
        return found


def rolled(P: Float[Array, "4 *curve u 2"], forward: bool) -> Float[Array, "3 *curve u 3"]:
    """Return x, y and heading of curves in the plane, with first and second derivatives.

    Args:
        P: Points and their first three derivatives.
        forward: Whether the heading is that of the tangent, or the opposite.
    """
    (x1, y1), (x2, y2), (x3, y3) = (np.moveaxis(P[k], -1, 0) for k in (1, 2, 3))
    squared = np.maximum(x1 * x1 + y1 * y1, 1e-12)
    sign = 1.0 if forward else -1.0
    yaw = np.arctan2(sign * y1, sign * x1)
    rate = (x1 * y2 - y1 * x2) / squared
    bend = (x1 * y3 - y1 * x3) / squared - 2.0 * rate * (x1 * x2 + y1 * y2) / squared
    return np.stack([np.concatenate([P[k], part[..., None]], axis=-1) for k, part in enumerate((yaw, rate, bend))])


@dataclass(frozen=True, eq=False)
class Drive:
    """Stretches one after the other, with a rest at each end of each.

    Args:
        stretches: At least one; each begins where the one before ends.
    """

    stretches: tuple[Stretch, ...]

    def grid(self, density: int) -> CurveGrid:
        """Sample it for timing; see `Curve`."""
        s, q, slope, bend, stop = [np.zeros(1)], [], [], [], [np.array([True])]
        for stretch in self.stretches:
            u, (at, first, second) = stretch.samples(density)
            q.append(at[:-1])
            slope.append(np.stack([first[:-1], first[1:]], axis=1))
            bend.append(np.stack([second[:-1], second[1:]], axis=1))
            s.append(s[-1][-1] + u[1:])
            stop.append(np.arange(1, len(u)) == len(u) - 1)
        end = self.stretches[-1].samples(1)[1][0, -1:]
        return CurveGrid(np.concatenate(s), np.concatenate([*q, end]), *map(np.concatenate, (slope, bend, stop)))


def drive_limits(base: DiffDrive, grid: CurveGrid) -> Float[Array, "interval limit 3"]:
    """Return limits a u + b x <= c of a base on path acceleration u and squared path speed x.

    What is along and across the heading, and the rims of the wheels: rate of turning and its acceleration are limits of
    the heading's joint. At the end of an interval the squared speed is x + 2 step u.
    """
    steps, rows = np.diff(grid.s), []
    for end in (0, 1):
        q, slope, bend = grid.q[end : len(grid.q) - 1 + end], grid.slope[:, end], grid.bend[:, end]
        along = np.stack([np.cos(q[:, 2]), np.sin(q[:, 2])], axis=1)
        forward, pushed = (along * slope[:, :2]).sum(axis=1), (along * bend[:, :2]).sum(axis=1)
        turn = slope[:, 2]
        zero = np.zeros_like(turn)
        for a, b, c in (
            (forward, pushed, _KEPT * base.a_max),
            (-forward, -pushed, _KEPT * base.a_max),
            (zero, forward * turn, base.lateral_max),
            (zero, -forward * turn, base.lateral_max),
            (zero, forward**2, base.v_max**2),
            (zero, (np.abs(forward) + base.lever * np.abs(turn)) ** 2, base.rim_max**2),
        ):
            rows.append(np.stack([a + (2.0 * steps * b if end else 0.0), b, np.full_like(b, c)], axis=-1))
    return np.stack(rows, axis=1)


def connected(stretches: Sequence[Stretch]) -> Drive:
    """Return the stretches that lead anywhere as one drive."""
    return Drive(
        tuple(one for one in stretches if not (isinstance(one, Straight) and np.array_equal(one.begin, one.end)))
    )

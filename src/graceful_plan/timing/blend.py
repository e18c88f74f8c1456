"""Polylines with rounded corners, for retiming.

At a corner of a polyline the direction jumps, so a robot would have to stop there. A parabola tangent to both segments
replaces the corner. On it the second derivative is constant; on the straight rest it is zero. Of all blends that cut
the corner by the same distance, the parabola has the smallest curvature.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.path import Path

SHORTEST_SEGMENT = 1e-5
"""Vertices closer than this to the previous one are merged [rad]: no robot can distinguish them."""

_BLENDED_SHARE = 0.475
"""Fraction of a segment that a blend at one end may take; the middle that remains is long enough to be timed."""

_INTERVALS = 100
"""Approximate number of intervals in the coarsest grid of a curve."""

_STRAIGHT = 1e-7
"""Change of the unit tangent below which there is no corner."""

_GRADING = np.array([1 / 16, 1 / 4])
"""Where to split the first interval after a rest, as fractions, to resolve a short acceleration phase."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of the curve: a line, or a parabola that turns the direction from `tangent` to `tangent + turn`."""

    length: float
    """Length in the curve's parameter [rad]; on lines this is arc length."""
    start: Float[Array, " nq"]
    tangent: Float[Array, " nq"]
    turn: Float[Array, " nq"]
    """Zero for a line."""
    stops_after: bool
    """Whether a sharp corner follows, where the motion must stop."""


@dataclass(frozen=True, eq=False)
class CurveGrid:
    """Samples of a curve at both ends of small intervals; left and right derivatives at a point may differ."""

    s: Float[Array, " point"]
    """Parameter of the grid points: [rad] for a polyline, in knots for a spline."""
    q: Float[Array, "point nq"]
    slope: Float[Array, "interval 2 nq"]
    """dq/ds at the beginning and at the end of each interval [rad per unit of s]."""
    bend: Float[Array, "interval 2 nq"]
    """d2q/ds2 at the beginning and at the end of each interval."""
    stop: Bool[Array, " point"]
    """Grid points where the motion must rest: the ends and sharp corners."""


@runtime_checkable
class Curve(Protocol):
    """A curve in configuration space that can be timed."""

    def grid(self, density: int) -> CurveGrid:
        """Sample the curve, more finely at higher density; the motion rests at both ends."""
        ...


@dataclass(frozen=True, eq=False)
class Polyline:
    """A polyline whose corners are rounded by parabolas.

    Args:
        pieces: Lines and parabolas, at least one.
        end: Last point of the curve, stored to avoid rounding errors there.
    """

    pieces: tuple[Piece, ...]
    end: Float[Array, " nq"]

    def grid(self, density: int) -> CurveGrid:
        """Sample it for timing; see `Curve`."""
        spacing = sum(piece.length for piece in self.pieces) / (_INTERVALS * density)
        return sampled(self.pieces, self.end, spacing, density)


def merge_near_vertices(path: Path) -> Float[Array, "n nq"]:
    """Drop vertices closer than `SHORTEST_SEGMENT` to the last one kept; the first and last vertices always stay."""
    kept = [path.q[0]]
    for q in path.q[1:]:
        if np.linalg.norm(q - kept[-1]) >= SHORTEST_SEGMENT:
            kept.append(q)
    if len(kept) > 1:
        kept[-1] = path.q[-1]
    return np.array(kept)


def rounded(path: Path, deviation: float | Float[Array, " corner"]) -> tuple[Piece, ...]:
    """Round the corners of a polyline by parabolas that stay within `deviation` [rad] of them.

    A blend takes less than half of each adjacent segment. A deviation of 0 leaves corners sharp.
    A path without length has no pieces.

    Args:
        path: The polyline.
        deviation: One value for all corners, or one for each inner vertex of `merge_near_vertices`.
    """
    q = merge_near_vertices(path)
    if len(q) < 2:
        return ()
    lengths, tangents, turns = _segments(q)
    reach = np.concatenate([[0.0], _reach(lengths, turns, deviation), [0.0]])
    sharp = np.concatenate([[False], np.linalg.norm(turns, axis=1) > _STRAIGHT, [True]])
    none = np.zeros(q.shape[1])
    pieces: list[Piece] = []
    for i, (length, tangent) in enumerate(zip(lengths, tangents, strict=True)):
        straight = length - reach[i] - reach[i + 1]
        blended = reach[i + 1] > 0.0
        pieces.append(Piece(straight, q[i] + reach[i] * tangent, tangent, none, bool(sharp[i + 1] and not blended)))
        if blended:
            pieces.append(Piece(2.0 * reach[i + 1], q[i + 1] - reach[i + 1] * tangent, tangent, turns[i], False))
    return tuple(pieces)


def rounded_corners(q: Float[Array, "n nq"], deviation: float, samples: int = 9) -> Float[Array, "corner sample nq"]:
    """Sample the parabolas that replace the corners of a polyline; its vertices must not coincide."""
    lengths, tangents, turns = _segments(q)
    reach = _reach(lengths, turns, deviation)[:, None, None]
    u = np.linspace(0.0, 2.0, samples)[None, :, None]
    start = q[1:-1, None] - reach * tangents[:-1, None]
    return start + reach * (u * tangents[:-1, None] + 0.25 * u * u * turns[:, None])


def _segments(
    q: Float[Array, "n nq"],
) -> tuple[Float[Array, " edge"], Float[Array, "edge nq"], Float[Array, "corner nq"]]:
    """Return the lengths and directions of the segments, and the change of direction at each inner vertex."""
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    tangents = np.diff(q, axis=0) / lengths[:, None]
    return lengths, tangents, np.diff(tangents, axis=0)


def _reach(
    lengths: Float[Array, " edge"], turns: Float[Array, "corner nq"], deviation: float | Float[Array, " corner"]
) -> Float[Array, " corner"]:
    """Return the distance from each corner to both ends of its parabola [rad]."""
    sharpness = np.linalg.norm(turns, axis=1)
    # The middle of a parabola of reach d is d/4 * |turn| away from its corner.
    room = _BLENDED_SHARE * np.minimum(lengths[:-1], lengths[1:])
    reach = np.minimum(4.0 * deviation / np.maximum(sharpness, 1e-12), room)
    return np.where(sharpness > _STRAIGHT, reach, 0.0)


def sampled(pieces: tuple[Piece, ...], end: Float[Array, " nq"], spacing: float, density: int = 1) -> CurveGrid:
    """Sample a curve on a grid for time-optimal timing.

    Args:
        pieces: The curve.
        end: Last point of the curve, stored to avoid rounding errors there.
        spacing: Largest distance of grid points [rad].
        density: Multiplies the smallest number of intervals on a piece.
    """
    length = np.array([piece.length for piece in pieces])
    start, tangent, turn = (np.array([getattr(p, name) for p in pieces]) for name in ("start", "tangent", "turn"))
    stops = np.array([piece.stops_after for piece in pieces])
    turned = np.linalg.norm(turn, axis=1)
    least = np.where(turned == 0.0, 4, 2 + np.ceil(4.0 * np.minimum(1.0, turned)).astype(int))
    count = np.maximum(density * least, 2 * np.ceil(length / (2.0 * spacing)).astype(int))
    rests = zip(count.tolist(), [True, *stops[:-1].tolist()], stops.tolist(), strict=True)
    shares = [places(n, from_rest=before, to_rest=after) for n, before, after in rests]
    # All intervals of all pieces in sequence: where each begins and ends, as fractions of its piece.
    begin, finish = (np.concatenate([share[part] for share in shares]) for part in (slice(-1), slice(1, None)))
    intervals = np.array([len(share) - 1 for share in shares])
    of = np.repeat(np.arange(len(pieces)), intervals)
    u = (begin * length[of])[:, None]
    q = start[of] + u * (tangent[of] + (0.5 * begin[:, None]) * turn[of])
    slope = tangent[of][:, None] + np.stack([begin, finish], axis=1)[:, :, None] * turn[of][:, None]
    bend = np.repeat((turn / length[:, None])[of][:, None], 2, axis=1)
    before = np.append(0.0, np.cumsum(length))
    stop = np.zeros(len(of) + 1, dtype=bool)
    stop[np.cumsum(intervals)] = stops
    stop[0] = True
    s = np.append(0.0, before[of] + finish * length[of])
    return CurveGrid(s, np.concatenate([q, end[None]]), slope, bend, stop)


@lru_cache(maxsize=256)
def places(n: int, *, from_rest: bool, to_rest: bool) -> Float[Array, " point"]:
    """Split 0 to 1 into `n` even intervals, with finer outer ones where the motion rests; the result is read-only."""
    before = _GRADING / n if from_rest else []
    after = 1.0 - _GRADING[::-1] / n if to_rest else []
    split = np.sort(np.concatenate([np.arange(n + 1) / n, before, after]))
    split.flags.writeable = False
    return split

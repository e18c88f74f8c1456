"""Limits of a motion as constraint rows: position, velocity, acceleration, jerk, torque, clearance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import Kernels
from graceful_plan.planners.optimisers.nlp import Pattern
from graceful_plan.transcription.spline_program import LinearRows, SampleRows, Samples, SplineLayout, hermite
from graceful_plan.transcription.symbolic import SymbolicRobot

_POSITION, _VELOCITY, _ACCELERATION, _JERK = range(4)
_TORQUE_RESERVE = 0.005
"""Fraction of the torque limits kept in reserve; a slowdown cannot remove an excess that holding still causes."""
_CLEARANCE_UNIT = 0.05
"""Clearance that counts as 1 in its rows [m], so that all rows are O(1)."""


def position_rows(layout: SplineLayout, lower: Float[Array, " nq"], upper: Float[Array, " nq"]) -> LinearRows:
    """Limit positions at the middles of the pieces; those at the nodes are bounds of variables."""
    rows = _piece_rows("position", layout, np.array([0.5]), _POSITION, np.ones(layout.nq))
    return replace(rows, least=np.tile(lower, layout.pieces), most=np.tile(upper, layout.pieces))


def velocity_rows(layout: SplineLayout, limit: Float[Array, " nq"]) -> LinearRows:
    """Limit velocities at the beginnings and middles of the pieces."""
    return _piece_rows("velocity", layout, np.array([0.0, 0.5]), _VELOCITY, limit)


def acceleration_rows(layout: SplineLayout, limit: Float[Array, " nq"]) -> LinearRows:
    """Limit accelerations at both ends of the pieces; they are linear in between."""
    return _piece_rows("acceleration", layout, np.array([0.0, 1.0]), _ACCELERATION, limit)


def jerk_rows(layout: SplineLayout, limit: Float[Array, " nq"]) -> LinearRows:
    """Limit the jerk of each piece."""
    return _piece_rows("jerk", layout, np.array([0.5]), _JERK, limit)


def continuity_rows(layout: SplineLayout, limit: Float[Array, " nq"]) -> LinearRows:
    """Require accelerations to be continuous between pieces, and 0 at start and end."""
    nq, pieces = layout.nq, layout.pieces
    node, end, joint = (grid.ravel() for grid in np.indices((pieces + 1, 2, nq)))
    row = node * nq + joint
    last, first = hermite(np.array([1.0, 0.0]))[:, _ACCELERATION]
    found: list[tuple[Array, Array, Array]] = []
    for coefficient, piece, sign in ((last, node - 1, 1.0), (first, node, -1.0)):
        for place in range(2):
            inside = (piece >= 0) & (piece < pieces)
            column = 2 * nq * (piece + place) + nq * end + joint
            entry = sign * coefficient[2 * place + end] / limit[joint]
            found.append((row[inside], column[inside], entry[inside]))
    rows, columns, entries = (np.concatenate(part) for part in zip(*found, strict=True))
    # Both pieces have an entry for their common node.
    keys, slot = np.unique(rows * layout.size + columns, return_inverse=True)
    n = (pieces + 1) * nq
    return LinearRows(
        "acceleration continuity",
        Pattern(keys // layout.size, keys % layout.size),
        np.bincount(slot, entries),
        _ACCELERATION,
        np.zeros(n),
        np.zeros(n),
    )


def _piece_rows(
    name: str, layout: SplineLayout, u: Float[Array, " n"], order: int, limit: Float[Array, " nq"]
) -> LinearRows:
    """Limit a derivative over its limit to [-1, 1] at fractions `u` of every piece."""
    nq = layout.nq
    finite = np.flatnonzero(np.isfinite(limit))
    piece, k, which, end = (grid.ravel() for grid in np.indices((layout.pieces, len(u), len(finite), 4)))
    joint = finite[which]
    coefficient = hermite(u)[k, order, end]
    n = layout.pieces * len(u) * len(finite)
    keep = coefficient != 0.0
    column = 2 * nq * piece + nq * end + joint
    pattern = Pattern(np.repeat(np.arange(n), 4)[keep], column[keep])
    one = np.ones(n)
    return LinearRows(name, pattern, (coefficient / limit[joint])[keep], order, -one, one)


def torque_rows(samples: Samples, robot: SymbolicRobot, limit: Float[Array, " nq"]) -> SampleRows:
    """Limit torques at samples, with a small reserve for the time between samples."""

    def bounded(states: Float[Array, "order n nq"]) -> tuple[Array, Array]:
        torque, slopes = robot.torques_with_slopes(*states)
        n, nq = torque.shape
        return torque / limit, (slopes / limit[:, None]).reshape(n, nq, 3, nq)

    most = np.full((len(samples), len(limit)), 1.0 - _TORQUE_RESERVE)
    return SampleRows("torque", samples, bounded, -most, most)


def clearance_rows(samples: Samples, kernels: Kernels, least: Float[Array, " n"]) -> SampleRows:
    """Keep the clearance of the covering spheres at `least` [m] or more."""

    def bounded(states: Float[Array, "order n nq"]) -> tuple[Array, Array]:
        clearance, gradient = kernels.clearance_gradient(states[0])
        slope = np.zeros((len(clearance), 1, 3, states.shape[2]))
        slope[:, 0, 0] = gradient / _CLEARANCE_UNIT
        # Without obstacles the clearance is infinite, but IPOPT needs finite numbers.
        return np.minimum(clearance, 1.0)[:, None] / _CLEARANCE_UNIT, slope

    none = np.full((len(samples), 1), np.inf)
    return SampleRows("clearance", samples, bounded, least[:, None] / _CLEARANCE_UNIT, none)


def samples_at(layout: SplineLayout, u: Float[Array, " n"], first: bool = True) -> Samples:
    """Return samples at fractions `u` of every piece."""
    piece = np.repeat(np.arange(layout.pieces), len(u))
    share = np.tile(u, layout.pieces)
    keep = slice(None) if first else piece + share > 0.0
    return Samples(layout, piece[keep], share[keep])

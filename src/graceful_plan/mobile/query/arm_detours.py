"""Arm motions to a goal posture around one corner, for a standing base whose straight arm motion is blocked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.path import Path
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE

_BASE = 3
"""Number of joints of the base, which precede those of the arm."""
_CORNERS = 400
"""Number of random corners."""
_SPREAD = (0.2, 1.5)
"""Standard deviation of the corners around the line between both ends [rad or m], from the first to the last."""


def with_arm_detours(ends: Endpoints) -> Endpoints:
    """Add, for each goal whose straight arm motion at the goal is blocked, an arrival around a corner.

    The base then drives with the start posture. All other arrivals are kept.
    """
    start, found = ends.departure.q[-1], []
    if start.size == _BASE:
        return ends
    goals = np.stack([arrival.q[-1] for arrival in ends.arrivals])
    standing = np.column_stack([goals[:, :_BASE], np.tile(start[_BASE:], (len(goals), 1))])
    moves = np.abs(goals - standing).max(axis=1) > 0.0
    kernels = ends.constraints.kernels
    blocked = moves & kernels.free(standing, TARGET_CLEARANCE)
    blocked[blocked] = ~kernels.edges_free(standing[blocked], goals[blocked], margin=TARGET_CLEARANCE)
    for k in np.flatnonzero(blocked):
        way = _round_a_corner(standing[k], goals[k], ends.constraints)
        found += [(Path(way), ends.goal_index[k])] if way is not None else []
    arrivals, index = (*ends.arrivals, *(way for way, _ in found)), (*ends.goal_index, *(k for _, k in found))
    return replace(ends, arrivals=arrivals, goal_index=index)


def _round_a_corner(
    a: Float[Array, " nq"], b: Float[Array, " nq"], constraints: SceneConstraints
) -> Float[Array, "3 nq"] | None:
    """Return the shortest motion from a to b over a random corner; None if none is free."""
    rng, kernels = np.random.default_rng(0), constraints.kernels
    share = rng.uniform(-0.2, 1.2, (_CORNERS, 1))
    middle = (1.0 - share) * a + share * b
    spread = np.linspace(*_SPREAD, _CORNERS)[:, None] * np.minimum(1.0, kernels.robot.upper - kernels.robot.lower)
    middle[:, _BASE:] += spread[:, _BASE:] * rng.normal(size=(_CORNERS, a.size - _BASE))
    corner = kernels.projected(np.clip(middle, kernels.robot.lower, kernels.robot.upper), TARGET_CLEARANCE)
    corner[:, :_BASE] = a[:_BASE]
    free = kernels.free(corner, TARGET_CLEARANCE)
    for end in (a, b):
        free[free] = kernels.edges_free(corner[free], end, margin=TARGET_CLEARANCE)
    if not free.any():
        return None
    length = np.linalg.norm(corner - a, axis=1) + np.linalg.norm(corner - b, axis=1)
    return np.stack([a, corner[np.argmin(np.where(free, length, np.inf))], b])

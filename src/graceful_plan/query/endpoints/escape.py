"""Escape paths: from a configuration that is free by exact geometry to one that is free by the fast checker.

The spheres of the fast checker protrude by up to a centimetre, so a gripper close to a table, or an object that still
stands on it, seems to collide. A short move up the gradient of clearance leaves such a start or goal; exact geometry
checks the move.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.judge.exact import first_collision
from graceful_plan.path import Path

TARGET_CLEARANCE = 0.002
"""Clearance at the planner's end of an escape path [m]."""
_LEAST = 1e-5
"""Clearance that is enough if no escape path is found [m]."""
_MAX_STEP = 0.05
"""Largest gradient step [rad]."""
_MAX_LENGTH = 1.0
"""Largest length of an escape path [rad]; a longer one would end far from the real start or goal."""


def way_out(
    q: Float[Array, " nq"],
    constraints: SceneConstraints,
    rng: np.random.Generator,
    attempts: int = 8,
    *,
    over: Callable[[], bool] = lambda: False,
) -> Path | None:
    """Find a short path from `q` to a configuration with clearance; the path is free by exact geometry.

    Args:
        q: A configuration that is free by exact geometry, except for contacts that are allowed at the ends.
        constraints: Constraints and scene.
        rng: Random numbers for perturbing `q` before each attempt except the first.
        attempts: Number of attempts.
        over: Returns whether the time for attempts is over.

    Returns:
        The path, a single configuration if `q` has clearance; None if no escape path was found.
    """
    tight = float(constraints.clearance(q[None])[0])
    if tight >= TARGET_CLEARANCE:
        return Path(q[None])
    for attempt in range(attempts):
        if over():
            break
        nudge = rng.normal(size=len(q)) * 0.01 * attempt
        end = ascend(q + nudge, constraints)
        if end is None:
            continue
        path = Path(np.stack([q, end]))
        if path.length < _MAX_LENGTH and first_collision(path, constraints.scene) is None:
            return path
    return Path(q[None]) if tight > _LEAST else None


def ascend(q: Float[Array, " nq"], constraints: SceneConstraints, iterations: int = 80) -> Float[Array, " nq"] | None:
    """Follow the gradient of clearance to `TARGET_CLEARANCE`; return None if it vanishes before."""
    kernels = constraints.kernels
    lower, upper = kernels.robot.lower, kernels.robot.upper
    q = np.clip(q, lower, upper)
    for _ in range(iterations):
        clearance, gradient = kernels.clearance_gradient(q)
        if clearance >= TARGET_CLEARANCE:
            return q
        slope = float(gradient @ gradient)
        if slope < 1e-8:
            return None
        step = gradient * (2.0 * TARGET_CLEARANCE - float(clearance)) / slope
        q = np.clip(q + step * min(1.0, _MAX_STEP / float(np.linalg.norm(step))), lower, upper)
    return None

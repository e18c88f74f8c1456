"""Ways out of tight places: from a configuration free by exact geometry to one that the fast checker calls free.

The fast checker's spheres stick out by up to a centimetre, so a gripper close to a table or an object that still stands
on it seem to collide. Such a start or goal is left by a short move up the gradient of clearance, checked by exact
geometry.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.judge.exact import first_collision
from graceful_plan.path import Path

Array = np.ndarray

TARGET_CLEARANCE = 0.002
"""Clearance at which the planner takes over [m]."""
_LEAST = 1e-5
"""Clearance with which a planner can start where no way out is found [m]."""
_MAX_STEP = 0.05
"""Of one gradient step [rad]."""
_MAX_LENGTH = 1.0
"""A way out that is longer leads somewhere else [rad]."""


def way_out(
    q: Float[Array, " nq"],
    constraints: SceneConstraints,
    rng: np.random.Generator,
    attempts: int = 8,
    *,
    over: Callable[[], bool] = lambda: False,
) -> Path | None:
    """Find a short exact-free path from `q` to a configuration with clearance.

    Args:
        q: A configuration that is free by exact geometry, contacts allowed at the ends aside.
        constraints: What has to hold there too, and where that is.
        rng: For a random nudge before each attempt but the first.
        attempts: How often to try.
        over: Whether there is no time for another attempt.

    Returns:
        The path, a single configuration if `q` has clearance; None if no way out was found.
    """
    tight = float(constraints.clearance(q[None])[0])
    if tight >= TARGET_CLEARANCE:
        return Path(q[None])
    for attempt in range(attempts):
        if over():
            break
        nudge = rng.normal(size=len(q)) * 0.01 * attempt
        end = _ascend(q + nudge, constraints)
        if end is None:
            continue
        path = Path(np.stack([q, end]))
        if path.length < _MAX_LENGTH and first_collision(path, constraints.scene) is None:
            return path
    return Path(q[None]) if tight > _LEAST else None


def _ascend(q: Float[Array, " nq"], constraints: SceneConstraints, iterations: int = 80) -> Float[Array, " nq"] | None:
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

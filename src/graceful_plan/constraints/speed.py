"""Limits of the tool's speed, as limits on the path speed of a curve."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.distance import distance_kernels
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.scene.rules.rules import SpeedRule
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.blend import CurveGrid

_RESERVE = 0.99
"""Fraction of the limit to use: the tool may be slightly faster between grid points."""


def speed_limits(rules: Sequence[SpeedRule], scene: Scene, grid: CurveGrid) -> Float[Array, "interval limit 3"]:
    """Return limits 0 u + b x <= c at both ends of each interval; b is 0 where a rule does not apply."""
    rows = [np.zeros((len(grid.s) - 1, 0, 3))]
    robot, kernels = compile_scene(scene).robot, compile_scene(scene).kernels
    steps = np.diff(grid.s)
    for rule in rules:
        for end in (0, 1):
            q = grid.q[end : len(grid.q) - 1 + end]
            slope, bend = (np.ascontiguousarray(x[:, end]) for x in (grid.slope, grid.bend))
            point = np.ascontiguousarray(robot.X_LT[:3, 3])
            velocity, _ = _native.point_derivatives(
                kernels.core, link=robot.tool_link, point=point, q=np.ascontiguousarray(q), slope=slope, bend=bend
            )
            squared = (velocity**2).sum(axis=1)
            if rule.near is not None:
                squared = np.where(distance_kernels(scene, rule.near).clearance(q) < rule.within, squared, 0.0)
            limit = np.full(len(q), (_RESERVE * rule.limit) ** 2)
            # At the end of an interval the squared speed is x + 2 step u.
            rows.append(np.stack([2.0 * steps * squared if end else 0.0 * squared, squared, limit], axis=-1)[:, None])
    return np.concatenate(rows, axis=1)

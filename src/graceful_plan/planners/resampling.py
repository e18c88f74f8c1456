"""Resampling of polylines."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float

Array = np.ndarray


def evenly(q: Float[Array, "vertex nq"], points: int) -> Float[Array, "point nq"]:
    """Return points at equal distances along a polyline, including both ends; corners between points are cut."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    s = np.linspace(0.0, arc[-1], points)
    return np.stack([np.interp(s, arc, q[:, joint]) for joint in range(q.shape[1])], axis=1)

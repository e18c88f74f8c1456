"""Limits of a base on the speed along a curve."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.timing.blend import CurveGrid

_KEPT = 0.99
"""Share of the acceleration limit along the heading that is used; between grid points it is exceeded by up to 1 %."""


def drive_limits(base: DiffDrive, grid: CurveGrid) -> Float[Array, "interval limit 3"]:
    """Return limits a u + b x <= c of a base on path acceleration u and squared path speed x.

    They bound the acceleration along and across the heading, the speed, and the rims of the wheels. The turning rate
    and its acceleration are limits of the heading's joint. At the end of an interval the squared speed is x + 2 step u.
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

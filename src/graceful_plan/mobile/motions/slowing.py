"""Where a base had better drive slowly: a failure does less harm there, and passing takes longer.

At each place of a curve one second costs its price and w times the impact, and passing takes as many seconds as one
over the speed. Of some shares of the fastest speed the one is taken at which passing costs least.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.mobile.motions.drive_curve import Drive
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.topp import Restraint
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

SHARES = np.array([1.0, 0.85, 0.7, 0.55, 0.4, 0.3, 0.2])
"""Of the fastest speed, that are compared."""
_LEAST = 0.05
"""Of the fastest speed of all joints, below which nothing is slowed down: it begins and ends at rest."""
_LOOKS = 200
"""Places of a motion that are looked at, about."""
_FREE = 1e9
"""Squared path speed where nothing is to be slower."""


def slower_where_it_pays(
    drive: Drive, trajectory: Trajectory, objective: SceneObjective, time_price: float
) -> Restraint | None:
    """Return limits on the path speed below that of a motion; None if it had better be as fast as it can everywhere.

    Args:
        drive: The curve.
        trajectory: As fast along it as the limits allow.
        objective: What is minimised.
        time_price: What a second costs besides.
    """
    grid = next((g for g in map(drive.grid, (1, 2, 4)) if len(g.q) == len(trajectory)), None)
    if objective.w == 0.0 or grid is None:
        return None
    every = max(1, len(trajectory) // _LOOKS)
    q, qd = trajectory.q[::every], trajectory.qd[::every]
    impact = np.stack([objective.quick_states(q, share * qd) for share in SHARES])
    price = (time_price + objective.w * impact) / SHARES[:, None]
    return capped(grid, trajectory, SHARES[np.argmin(price, axis=0)].repeat(every)[: len(trajectory)])


def capped(grid: CurveGrid, trajectory: Trajectory, share: Float[Array, " point"]) -> Restraint | None:
    """Return limits on the path speed at shares of that of a motion; None if they are 1 everywhere.

    Args:
        grid: Of the curve, at the samples of the motion.
        trajectory: The motion.
        share: At each of them.
    """
    if (share == 1.0).all():
        return None
    slope = np.linalg.norm(np.concatenate([grid.slope[:, 0], grid.slope[-1:, 1]]), axis=1)
    speed = np.linalg.norm(trajectory.qd, axis=1)
    # A stretch may be parametrised by metres, and the next one by shares of its length.
    slow = np.maximum(share * speed, _LEAST * speed.max()) / np.maximum(slope, 1e-12)
    cap = np.where(share < 1.0, slow**2, _FREE)
    s = grid.s

    def limits(of: CurveGrid) -> Float[Array, "interval limit 3"]:
        # Between two points the lower of both.
        k = np.clip(np.searchsorted(s, of.s, side="right") - 1, 0, len(s) - 2)
        at = np.minimum(cap[k], np.where(of.s > s[k], cap[k + 1], np.inf))
        steps, zero, one = np.diff(of.s), np.zeros(len(of.s) - 1), np.ones(len(of.s) - 1)
        begin = np.stack([zero, one, at[:-1]], axis=-1)
        end = np.stack([2.0 * steps, one, at[1:]], axis=-1)
        return np.stack([begin, end], axis=1)

    return limits

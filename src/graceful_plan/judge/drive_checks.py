"""Checks that a mobile base rolls and keeps its drive limits, from the cubics of the motion, also between samples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.result import Check
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.timing.trajectory import Trajectory

SIDEWAYS = 1e-3
"""Greatest sideways speed [m/s]; wheels on a floor slip by as much."""
_MISSED = 1e-2
"""Relative tolerance of a limit between the samples that a motion was timed at."""
_BETWEEN = 5
"""Number of evaluated times on each piece of a motion, including its ends."""
_ASKEW = 1e-3
"""Largest sideways displacement, and largest bulge while turning, on an edge of a path [m]."""


def drive_checks(motion: Path | Trajectory, base: DiffDrive) -> Mapping[str, Check]:
    """Check that a base rolls and, on a trajectory, keeps its limits along and across the heading and of its wheels."""
    if isinstance(motion, Path):
        return {"rolling": _rolls_along(motion)}
    pieces = np.diff(motion.t)
    share = np.linspace(0.0, 1.0, _BETWEEN)
    t = np.append((motion.t[:-1, None] + share[:-1] * pieces[:, None]).ravel(), motion.t[-1])
    state = motion.at(t)
    heading = state.q[:, 2]
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    v, side = (state.qd[:, :2] * along).sum(axis=1), (state.qd[:, :2] * across).sum(axis=1)
    omega = state.qd[:, 2]
    ratios = {
        "speed": np.abs(v) / base.v_max,
        "rate of turning": np.abs(omega) / base.omega_max,
        "acceleration": np.abs((state.qdd[:, :2] * along).sum(axis=1) + omega * side) / base.a_max,
        "acceleration of turning": np.abs(state.qdd[:, 2]) / base.alpha_max,
        "acceleration across": np.abs(v * omega) / base.lateral_max,
        "rim of a wheel": (np.abs(v) + base.lever * np.abs(omega)) / base.rim_max,
        **({} if base.reverse else {"reverse": np.where(v < -SIDEWAYS, 2.0, 0.0)}),
    }
    worst = max(ratios, key=lambda name: float(ratios[name].max()))
    return {
        "rolling": _check(np.abs(side), t, SIDEWAYS, "sideways speed of the base [m/s]"),
        "drive_limits": _check(ratios[worst], t, 1.0 + _MISSED, f"of the base's limit: {worst}"),
    }


def _rolls_along(path: Path) -> Check:
    """Check that each edge drives along the heading or turns in place."""
    way = np.diff(path.q[:, :3], axis=0)
    heading = 0.5 * (path.q[:-1, 2] + path.q[1:, 2])
    length = np.linalg.norm(way[:, :2], axis=1)
    side = np.abs(-way[:, 0] * np.sin(heading) + way[:, 1] * np.cos(heading))
    askew = np.where(length > 1e-6, np.maximum(side, length * np.abs(way[:, 2]) / 2.0), 0.0)
    return _check(askew, np.cumsum(length), _ASKEW, "across the heading, on an edge of the path [m]")


def _check(values: Float[Array, " n"], at: Float[Array, " n"], limit: float, words: str) -> Check:
    worst = float(values.max(initial=0.0))
    bad = np.flatnonzero(values > limit)
    first = float(at[bad[0]]) if len(bad) else None
    return Check(passed=worst <= limit, worst=worst, limit=limit, first=first, detail=f"{worst:.4g} {words}")

"""Vectorised functions shared by the drop models; the docstring of the package specifies them."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array
from graceful_plan.costs.models.drop.tables import BALL, ROUND

GRAVITY = 9.81
BETA = np.sqrt(3.0) / np.pi
"""Scale of a logistic distribution with standard deviation 1."""
_EXPONENT = 300.0
_SOFT = 0.01  # smoothing width of heights and margins around zero [m]


def step(u: Array) -> Array:
    """S: distribution function of a logistic variable with standard deviation 1."""
    return 1.0 / (1.0 + np.exp(np.clip(-u / BETA, -_EXPONENT, _EXPONENT)))


def smooth_step(x: Array) -> Array:
    """c: smooth step from 0 at -1 to 1 at 1; for x = d/w it models noise with a standard deviation of w/sqrt(5)."""
    t = np.clip(0.5 + 0.5 * x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def box(x: Array, A: Array, s: Array | float) -> Array:
    """P(|x + noise| < A) for logistic noise with standard deviation s."""
    A, b = np.maximum(A, 1e-4), s * BETA
    f = np.exp(np.clip((x - A) / b, -_EXPONENT, _EXPONENT))
    h = np.exp(np.clip(-(x + A) / b, -_EXPONENT, _EXPONENT))
    return (1.0 - f * h) / ((1.0 + f) * (1.0 + h))


def positive(x: Array) -> Array:
    """Return max(x, 0), smoothed around 0."""
    return 0.5 * (x + np.sqrt(x * x + _SOFT**2))


def fall_time(vz: Array, h: Array) -> Array:
    """Compute the time to fall from height h [m] with vertical velocity vz [m/s]; close to 0 for h < 0 [s]."""
    return (vz + np.sqrt(vz * vz + 2.0 * GRAVITY * positive(h))) / GRAVITY


def part_reach(axes: Array, half: Array, kind: int, u: Array) -> Array:
    """Compute the reach of a part (axes [n 3 3]) along unit vectors u [target 3] or [n target 3] in W: [n target]."""
    if kind == BALL:
        return np.full((len(axes), u.shape[-2]), half[0])
    along = u @ axes
    if kind == ROUND:
        z = along[..., 2]
        return np.abs(z) * half[2] + half[0] * np.sqrt(np.maximum(1e-12, 1.0 - z * z))
    return np.abs(along) @ half

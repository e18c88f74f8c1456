"""What of a curve may move in a descent, how far a step in each direction bends it, and what slopes tell of others."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.mobile.motions.drive_curve import Roll

Array = np.ndarray

_REMEMBERED = 8
"""Steps that directions follow from."""
_CONVEX = 1e-6
"""Cosine between a step and the change of slope along it, at least."""
_STIFF = 1e-3
"""Added to what measures bending, so that moving everything together costs something too."""


@final
class MovingCurve:
    """A curve as variables: inner control points, how far those next to the ends are from these, and those of the arm.

    Args:
        roll: The curve; its ends and its headings there stay.
        limits: Position limits of all joints [rad or m].
    """

    def __init__(self, roll: Roll, limits: Float[Array, "nq 2"]) -> None:
        self.of, self._limits = roll, limits
        C = roll.controls
        self._first, self._last = C[1, :2] - C[0, :2], C[-1, :2] - C[-2, :2]
        self._inner = n = max(0, len(C) - 4)
        self.first = np.concatenate([C[2:-2, :2].ravel(), [0.0, 0.0], C[1:-1, 2:].ravel()])
        """The variables of the curve as it is."""
        self.metric = np.zeros((len(self.first), len(self.first)))
        """From slopes to steps."""
        end, arm = 2 * n, C.shape[1] - 2
        self.metric[:end, :end] = np.kron(_unbent(n), np.eye(2))
        self.metric[end : end + 2, end : end + 2] = np.eye(2)
        if arm:
            self.metric[end + 2 :, end + 2 :] = np.kron(_unbent(n + 2), np.eye(arm))

    def controls(self, x: Float[Array, "curve variable"]) -> Float[Array, "curve control axis"]:
        """Return the control points of curves; the ends and the directions there stay."""
        C = np.broadcast_to(self.of.controls, (len(x), *self.of.controls.shape)).copy()
        n = self._inner
        C[:, 2 : 2 + n, :2] = x[:, : 2 * n].reshape(len(x), n, 2)
        first, last = (np.exp(np.clip(x[:, k], -2.0, 2.0))[:, None] for k in (2 * n, 2 * n + 1))
        C[:, 1, :2], C[:, -2, :2] = C[:, 0, :2] + first * self._first, C[:, -1, :2] - last * self._last
        # A spline stays between the least and the greatest of its control points.
        lower, upper = self._limits[len(self._limits) - (C.shape[2] - 2) :].T
        C[:, 1:-1, 2:] = np.clip(x[:, 2 * n + 2 :].reshape(len(x), n + 2, -1), lower, upper)
        return C

    def roll(self, x: Float[Array, " variable"]) -> Roll:
        """Return one of the curves."""
        return Roll(self.controls(x[None])[0], self.of.begin, self.of.end, self.of.forward)


@final
class Curvature:
    """Directions of a descent from the slopes before: limited-memory BFGS, from a metric.

    J. Nocedal, "Updating quasi-Newton matrices with limited storage", Mathematics of Computation 35 (1980).

    Args:
        metric: From slopes to steps, before anything is known.
    """

    def __init__(self, metric: Float[Array, "variable variable"]) -> None:
        self._metric = metric
        self._last: tuple[Array, Array] | None = None
        self._pairs: list[tuple[Array, Array]] = []

    @property
    def known(self) -> bool:
        """Whether directions follow from more than the metric."""
        return bool(self._pairs)

    def direction(self, x: Float[Array, " variable"], slope: Float[Array, " variable"]) -> Float[Array, " variable"]:
        """Return where to go from x, and remember it."""
        if self._last is not None:
            step, change = x - self._last[0], slope - self._last[1]
            if step @ change > _CONVEX * np.linalg.norm(step) * np.linalg.norm(change):
                self._pairs = [*self._pairs, (step, change)][-_REMEMBERED:]
        self._last = x, slope
        d, shares = slope.copy(), []
        for step, change in reversed(self._pairs):
            shares.append((step @ d) / (step @ change))
            d -= shares[-1] * change
        d = self._metric @ d
        if self._pairs:
            step, change = self._pairs[-1]
            d *= (step @ change) / (change @ self._metric @ change)
        for (step, change), share in zip(self._pairs, reversed(shares), strict=True):
            d += (share - (change @ d) / (step @ change)) * step
        return -d


def _unbent(n: int) -> Float[Array, "n n"]:
    """Return the inverse of what bending a row of control points costs."""
    bending = np.zeros((n + 2, n))
    for k in range(n):
        bending[k : k + 3, k] = 1.0, -2.0, 1.0
    return np.linalg.inv(bending.T @ bending + _STIFF * np.eye(n)) if n else np.zeros((0, 0))

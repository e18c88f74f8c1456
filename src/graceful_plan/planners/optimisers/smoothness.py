r"""Roughness of a path by finite differences, from which follow STOMP's noise and CHOMP's metric.

A path has n inner points between two fixed ends. With K the matrix of first or second differences, ends included,

.. math:: \tfrac12 |K q|^2 = \tfrac12 \theta^T A \theta + \theta^T b + c, \qquad A = K_\theta^T K_\theta

per joint, where theta are the inner points. Differences are not divided by the spacing of points: A is dimensionless,
and only its shape matters here. A has 2 * order + 1 diagonals, but for a path of about 100 points, applying its dense
inverse is faster than calling a banded solver.

References:
    Kalakrishnan et al., "STOMP: stochastic trajectory optimization for motion planning", ICRA 2011, Sec. II.
    Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013, Sec. 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.setting_checks import count, not_negative

_LIMIT_PASSES = 10
"""Largest number of bumps per joint; points that are still outside the limits are then clamped."""


@final
@dataclass(frozen=True)
class Smoothness:
    """Metric of paths with n inner points.

    Args:
        n: Number of inner points.
        order: 1 for first differences (short paths are smooth), 2 for second differences (straight, evenly spaced paths
            are smooth).
        tether: Value added to the diagonal of A, which penalises displacement itself: bumps and noise of order 2 then
            span about 6.7 / tether ** 0.25 points instead of the whole path.
    """

    n: int
    order: int = 2
    tether: float = 0.0

    def __post_init__(self) -> None:
        count("n", self.n)
        if self.order not in (1, 2):
            raise SettingError("order", self.order, "1 or 2")
        not_negative("tether", self.tether)

    @cached_property
    def difference(self) -> Float[Array, "row point"]:
        """The matrix K on all points, including both ends; there are no second differences at the ends."""
        stencil = np.diff(np.eye(self.order + 1), n=self.order, axis=0)[0]
        rows = self.n + 2 - self.order
        matrix = np.zeros((rows, self.n + 2))
        for offset, value in enumerate(stencil):
            matrix[np.arange(rows), np.arange(rows) + offset] = value
        return matrix

    @cached_property
    def matrix(self) -> Float[Array, "n n"]:
        """A, on the inner points; positive definite."""
        inner = self.difference[:, 1:-1]
        return inner.T @ inner + self.tether * np.eye(self.n)

    @cached_property
    def factor(self) -> Float[Array, "n n"]:
        """The lower Cholesky factor L of A = L L^T."""
        return np.linalg.cholesky(self.matrix)

    @cached_property
    def inverse(self) -> Float[Array, "n n"]:
        """The inverse of A; its columns are the smoothest bumps that displace one point."""
        return self._root @ self._root.T

    @cached_property
    def _root(self) -> Float[Array, "n n"]:
        return np.linalg.inv(self.factor).T  # L^-T, so that its product with white noise has the covariance A^-1

    def solve(self, force: Float[Array, "*batch n nq"]) -> Float[Array, "*batch n nq"]:
        """Return the smoothest displacement of the inner points along a force: A^-1 force."""
        return self.inverse @ force

    def noise(self, rollouts: int, nq: int, rng: np.random.Generator) -> Float[Array, "rollout n nq"]:
        """Draw Gaussian displacements of the inner points with covariance A^-1, independently for each joint.

        The largest standard deviation of any point is scaled to 1. The noise falls to 0 smoothly towards the ends,
        since they are part of A.
        """
        white = rng.standard_normal((rollouts, self.n, nq))
        return (self._root / np.sqrt(self.inverse.diagonal().max())) @ white

    def into_limits(
        self, inner: Float[Array, "*batch n nq"], lower: Float[Array, " nq"], upper: Float[Array, " nq"]
    ) -> Float[Array, "*batch n nq"]:
        """Move inner points into the limits smoothly: in each pass, a bump moves the worst point of each joint.

        Bumps overlap, so points that are still outside after some passes are clamped.
        """
        moved = inner.copy()
        for _ in range(_LIMIT_PASSES):
            excess = moved - np.clip(moved, lower, upper)
            if not excess.any():
                return moved
            worst = np.abs(excess).argmax(axis=-2)[..., None, :]
            height = np.take_along_axis(excess, worst, axis=-2) / self.inverse.diagonal()[worst]
            moved -= np.moveaxis(self.inverse[worst[..., 0, :]], -1, -2) * height
        return np.clip(moved, lower, upper)

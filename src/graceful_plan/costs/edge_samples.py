"""Samples of straight edges: integrals along edges, and their derivatives with respect to both ends."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import COST_STEP


@final
class EdgeSamples:
    """Evenly spaced samples of many edges in one batch, including both ends of each, with trapezoid weights.

    Speeds alternate between the two `paces`, each a fraction of the speed at which the first joint reaches its limit.
    """

    def __init__(
        self,
        q0: Float[Array, "n nq"],
        q1: Float[Array, "n nq"],
        velocity: Float[Array, " nq"],
        paces: tuple[float, float],
        step: float = COST_STEP,
    ) -> None:
        delta = q1 - q0
        self.length = np.linalg.norm(delta, axis=1)
        at_limit = np.max(np.abs(delta) / velocity, axis=1, initial=0.0)
        self.duration = at_limit / (0.5 * sum(paces))
        pieces = np.maximum(1, np.ceil(self.length / step)).astype(int)
        self.first = np.cumsum(pieces + 1) - (pieces + 1)
        self.edge = np.repeat(np.arange(len(q0)), pieces + 1)
        self._piece = np.arange(len(self.edge)) - self.first[self.edge]
        self._pieces = pieces
        s = self._piece / pieces[self.edge]
        self.place = self.edge + s
        self.q = q0[self.edge] + s[:, None] * delta[self.edge]
        safe = np.where(self.length > 0, self.length, 1.0)
        self.direction = (delta / safe[:, None])[self.edge]
        limit = np.where(at_limit > 0, self.length / np.where(at_limit > 0, at_limit, 1.0), 0.0)
        self._pace = np.array(paces)[self._piece % 2]
        self.speed = limit[self.edge] * self._pace
        self._delta, self._velocity, self._paces = delta, velocity, paces

    def weights(self, measure: Float[Array, " n"]) -> Float[Array, " m"]:
        """Compute the trapezoid weight of each sample for edges with these measures."""
        ends = (self._piece == 0) | (self._piece == self._pieces[self.edge])
        return np.where(ends, 0.5, 1.0) * (measure / self._pieces)[self.edge]

    def integral(self, values: Float[Array, "..."], measure: Float[Array, " n"]) -> Float[Array, "..."]:
        """Integrate sampled values over each edge; trailing axes of the values are kept."""
        if len(self.first) == 0:
            return np.zeros((0, *values.shape[1:]))
        weight = self.weights(measure).reshape(-1, *(1,) * (values.ndim - 1))
        return np.add.reduceat(values * weight, self.first)

    def integral_slopes(
        self, slopes: tuple[Float[Array, " m"], Float[Array, "m nq"], Float[Array, "m nq"]], *, by_length: bool
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Integrate over length or time, with derivatives with respect to both ends of each edge.

        The derivatives of an edge without length are undefined; they are returned as 0.

        Args:
            slopes: Value of each sample, and its derivatives with respect to q and to the joint velocities.
            by_length: Whether to integrate over length instead of time.
        """
        value, d_q, d_qd = slopes
        measure = self.length if by_length else self.duration
        share = (self.place - self.edge)[:, None]
        whole = self.integral(value, measure)
        d_q0, d_q1 = self.integral((1.0 - share) * d_q, measure), self.integral(share * d_q, measure)
        moves = self.length > 0.0
        delta, length = self._delta[moves], self.length[moves, None]
        # The joint that reaches its limit first sets the duration; d(duration)/d(delta) is its sign over its limit.
        slowest = np.argmax(np.abs(delta) / self._velocity, axis=1)
        rows = np.arange(len(delta))
        fastest = np.zeros_like(delta)
        fastest[rows, slowest] = np.sign(delta[rows, slowest]) / self._velocity[slowest]
        stretch = delta / length if by_length else fastest / (0.5 * sum(self._paces))
        longer = (whole[moves] / measure[moves])[:, None] * stretch
        # Velocities are delta times the pace over the time at full speed.
        at_limit = np.max(np.abs(delta) / self._velocity, axis=1, initial=0.0)[:, None]
        by_qd = self.integral(self._pace[:, None] * d_qd, measure)[moves] / at_limit
        longer += by_qd - np.sum(by_qd * delta, axis=1, keepdims=True) / at_limit * fastest
        d_q0[moves] -= longer
        d_q1[moves] += longer
        return whole, d_q0, d_q1

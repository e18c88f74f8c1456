"""Samples of straight edges: integrals along them, and the derivatives of these with respect to both ends."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.kernels import COST_STEP

Array = np.ndarray


@final
class EdgeSamples:
    """Evenly spaced samples of many edges in one batch, both ends of each included, with trapezoid weights.

    Their speeds are by turns the first and the second of `paces`, times that of the slowest joint at its limit.
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
        """Trapezoid weight of each sample when each edge measures `measure`."""
        ends = (self._piece == 0) | (self._piece == self._pieces[self.edge])
        return np.where(ends, 0.5, 1.0) * (measure / self._pieces)[self.edge]

    def integral(self, values: Float[Array, "..."], measure: Float[Array, " n"]) -> Float[Array, "..."]:
        """Integral of sampled values over each edge; of several values a sample, of each of them."""
        if len(self.first) == 0:
            return np.zeros((0, *values.shape[1:]))
        weight = self.weights(measure).reshape(-1, *(1,) * (values.ndim - 1))
        return np.add.reduceat(values * weight, self.first)

    def integral_slopes(
        self, slopes: tuple[Float[Array, " m"], Float[Array, "m nq"], Float[Array, "m nq"]], *, by_length: bool
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Integral over length or over time, and its derivatives with respect to both ends of each edge.

        An edge without length has none; they are given as 0.

        Args:
            slopes: Of each sample the value and its derivatives with respect to q and to the joint velocities.
            by_length: Whether to integrate over length.
        """
        value, d_q, d_qd = slopes
        measure = self.length if by_length else self.duration
        share = (self.place - self.edge)[:, None]
        whole = self.integral(value, measure)
        d_q0, d_q1 = self.integral((1.0 - share) * d_q, measure), self.integral(share * d_q, measure)
        moves = self.length > 0.0
        delta, length = self._delta[moves], self.length[moves, None]
        # The slowest joint sets the time: its sign over its limit is the derivative of the time at full speed.
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

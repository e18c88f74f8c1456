"""A path as a nonlinear program: its inner points, the total cost of its edges, and clearance along them."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.nlp import Pattern, Program, Values
from graceful_plan.planners.edge_derivatives import Slopes

Array = np.ndarray

_UNIT = 0.05
"""Clearance [m] that counts as one in a constraint, so that all of them are of O(1)."""
_FAR = 20.0
"""Clearance in these units beyond which it does not matter."""
_SHIFT = 1e-3
"""How far edges are moved as a whole, for the curvature of the cost [rad]."""
_SLIDE = 0.02
"""Curvature along an edge, relative to that across: points may slide along a path, but not freely."""
_SHORT = 1e-6
"""Length [rad] below which edges count as that long."""


class PathProgram(Program):
    """Minimise J over the inner points of a path within joint limits, with clearance as constraint.

    The Hessian is made of what bends the path, the density of the cost times the curvature of its length, and of the
    curvature of the density, from differences of gradients of edges that are moved as a whole; of that, only what is
    convex. The curvature of the clearance is left out.

    Args:
        q: Points to begin with, ends included.
        slopes: Questions to problem and objective.
        clearance: Clearance to keep beyond that of the problem.
        spacing: Largest distance between points of an edge at which the clearance is a constraint [rad].
        curved: Whether to ask for the curvature of the density; without, gradients have to be exact and are not.
    """

    def __init__(
        self, q: Float[Array, "point nq"], slopes: Slopes, clearance: float, spacing: float, curved: bool
    ) -> None:
        self._slopes, self._curved = slopes, curved
        self.start, self.goal = q[0], q[-1]
        self._n, self._nq = len(q) - 2, q.shape[1]
        problem = slopes.problem
        self.lower, self.upper = np.tile(problem.lower, self._n), np.tile(problem.upper, self._n)
        self._place(q, spacing)
        known = slopes.clearance_slopes(self._points(q))
        rows = 0 if known is None else len(self._edge)
        if known is not None:
            clearance = min(clearance, 0.5 * float(slopes.clearance_slopes(q[[0, -1]])[0].min()))  # pyright: ignore[reportOptionalSubscript]
        self.least, self.most = np.full(rows, clearance / _UNIT), np.full(rows, np.inf)
        self._limited = rows > 0
        self.jacobian_pattern = self._jacobian_pattern()
        self.hessian_pattern = self._hessian_pattern()

    def path(self, x: Float[Array, " variable"]) -> Float[Array, "point nq"]:
        """All points, ends included."""
        return np.concatenate([self.start[None], x.reshape(self._n, self._nq), self.goal[None]])

    def evaluate(self, x: Float[Array, " variable"]) -> Values:
        """Compute total cost and clearance with their derivatives."""
        q = self.path(x)
        cost, first, second = self._slopes.edge_slopes(q[:-1], q[1:])
        gradient = (second[:-1] + first[1:]).ravel()
        if not self._limited:
            return Values(float(cost.sum()), gradient, np.zeros(0), np.zeros(0))
        known = self._slopes.clearance_slopes(self._points(q))
        assert known is not None
        value = np.minimum(known[0] / _UNIT, _FAR)
        slope = np.where(value[:, None] < _FAR, known[1], 0.0) / _UNIT
        ends = np.stack([(1.0 - self._share)[:, None] * slope, self._share[:, None] * slope], axis=1)
        return Values(float(cost.sum()), gradient, value, ends[self._inner])

    def hessian(
        self, x: Float[Array, " variable"], factor: float, multipliers: Float[Array, " constraint"]
    ) -> Float[Array, " nonzero"]:
        """Convex part of the Hessian of the cost; that of the constraints is left out."""
        del multipliers
        q = self.path(x)
        q0, q1 = q[:-1], q[1:]
        length = np.maximum(np.linalg.norm(q1 - q0, axis=1), _SHORT)
        cost, _, _ = self._slopes.edge_slopes(q0, q1)
        tangent = (q1 - q0) / length[:, None]
        across = np.eye(self._nq) - (1.0 - _SLIDE) * tangent[:, :, None] * tangent[:, None, :]
        stiff = (cost / length**2)[:, None, None] * across
        bowl = self._bowl(q0, q1) if self._curved else np.zeros_like(stiff)
        same, other = stiff + 0.25 * bowl, -stiff + 0.25 * bowl
        blocks = same[:-1] + same[1:]
        upper = np.triu_indices(self._nq)
        return factor * np.concatenate([blocks[:, upper[0], upper[1]].ravel(), other[1:-1].ravel()])

    def _bowl(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n nq nq"]:
        """Convex part of the second derivative of what edges cost with respect to where they are."""
        n, nq = q0.shape
        move = _SHIFT * np.array([1.0, -1.0])[:, None, None, None] * np.eye(nq)[:, None, :]
        _, first, second = self._slopes.edge_slopes((q0 + move).reshape(-1, nq), (q1 + move).reshape(-1, nq))
        total = (first + second).reshape(2, nq, n, nq)
        matrix = np.moveaxis((total[0] - total[1]) / (2.0 * _SHIFT), 0, 1)
        value, vector = np.linalg.eigh(0.5 * (matrix + np.swapaxes(matrix, 1, 2)))
        return (vector * np.maximum(value, 0.0)[:, None]) @ np.swapaxes(vector, 1, 2)

    def _place(self, q: Float[Array, "point nq"], spacing: float) -> None:
        """Choose where on the edges the clearance is asked for: ends but the first and the last, and in between."""
        pieces = np.maximum(1, np.ceil(np.linalg.norm(np.diff(q, axis=0), axis=1) / spacing)).astype(int)
        edge = np.repeat(np.arange(len(pieces)), pieces)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[edge]
        inside = edge + share > 0.0
        self._edge: Int[Array, " row"] = edge[inside]
        self._share: Float[Array, " row"] = share[inside]
        end = self._edge[:, None] + np.arange(2)
        # The first point of the path and the last do not move; at a point, the rest of its edge does not matter.
        self._inner = (end > 0) & (end <= self._n) & ((self._share[:, None] > 0.0) | (np.arange(2) == 0))

    def _points(self, q: Float[Array, "point nq"]) -> Float[Array, "row nq"]:
        share = self._share[:, None]
        return (1.0 - share) * q[self._edge] + share * q[self._edge + 1]

    def _jacobian_pattern(self) -> Pattern:
        if not self._limited:
            return Pattern(np.zeros(0, dtype=int), np.zeros(0, dtype=int))
        row, end = np.nonzero(self._inner)
        column = (self._edge[row] + end - 1)[:, None] * self._nq + np.arange(self._nq)
        return Pattern(np.repeat(row, self._nq), column.ravel())

    def _hessian_pattern(self) -> Pattern:
        nq, point = self._nq, np.arange(self._n)[:, None] * self._nq
        upper = np.triu_indices(nq)
        row, column = (index.ravel() for index in np.indices((nq, nq)))
        next_to = point[:-1]
        return Pattern(
            np.concatenate([(point + upper[0]).ravel(), (next_to + row).ravel()]),
            np.concatenate([(point + upper[1]).ravel(), (next_to + nq + column).ravel()]),
        )

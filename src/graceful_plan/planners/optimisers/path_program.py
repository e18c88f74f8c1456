"""A path as a nonlinear program: inner points as variables, total cost J, clearance as constraint."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.nlp import Pattern, Program, Values
from graceful_plan.planners.optimisers.smoothness import Smoothness

_UNIT = 0.05
"""Unit of clearance in constraints [m], so that their values are of O(1)."""
_FAR = 20.0
"""Clearance in this unit from which on it is cut off."""
_COARSE = 30.0
"""Unit of the points among the variables [rad]; it is large so that they have little weight in the Hessian's
approximation."""


@final
class PathProgram(Program):
    r"""Minimise J over the inner points of a path, within joint limits and with clearance as constraint.

    The variables are the points q, and whitened variables that linear equations tie to them,

    .. math:: x = L^T (q - q_0), \qquad L L^T = A

    where A is the stiffness matrix of springs along the path, scaled by the cost of its edges, an approximation of the
    Hessian of J. J is a function of x, where its Hessian is close to the identity, from which IPOPT's limited-memory
    approximation starts. Limits and clearance are functions of q, so that all matrices are sparse: L has two diagonals.

    Args:
        q: Initial points, including the ends.
        slopes: Access to problem and objective.
        clearance: Clearance in addition to the problem's margin [m]; at most half of that of the ends.
        spacing: Largest distance between points of an edge at which the clearance is a constraint [rad].
        total: J of the initial path.
        reach: Largest move of a joint of any point [rad or m].
    """

    def __init__(
        self, q: Float[Array, "point nq"], slopes: Slopes, clearance: float, spacing: float, total: float, reach: float
    ) -> None:
        self._slopes, self._ends, problem = slopes, q[[0, -1]], slopes.problem
        self._n, self._nq = len(q) - 2, q.shape[1]
        self.first = np.append(q[1:-1].ravel() / _COARSE, np.zeros(self._n * self._nq))
        lower, upper = np.maximum(q[1:-1] - reach, problem.lower), np.minimum(q[1:-1] + reach, problem.upper)
        free = np.full(self._n * self._nq, np.inf)
        self.lower, self.upper = np.append(lower.ravel() / _COARSE, -free), np.append(upper.ravel() / _COARSE, free)
        length = max(float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum()), 1e-9)
        springs = Smoothness(self._n, 1).matrix * max(total, 1e-9) * (self._n + 1) / length**2
        factor = np.linalg.cholesky(springs)
        self._to_white = np.linalg.inv(factor)
        self._choose_places(q, spacing)
        self._tie(factor, q[1:-1])
        rows = len(self._edge)
        if rows:
            clearance = min(clearance, 0.5 * max(0.0, float(self._clearance(self._ends)[0].min())))
        self.least = np.append(np.full(rows, clearance / _UNIT), self._tied_to)
        self.most = np.append(np.full(rows, np.inf), self._tied_to)

    def path(self, x: Float[Array, " variable"]) -> Float[Array, "point nq"]:
        """Return all points, including the ends, clamped to the joint limits."""
        problem, inner = self._slopes.problem, _COARSE * x[: self._n * self._nq].reshape(self._n, self._nq)
        inner = np.clip(inner, problem.lower, problem.upper)  # against rounding errors
        return np.concatenate([self._ends[:1], inner, self._ends[1:]])

    def evaluate(self, x: Float[Array, " variable"]) -> Values:
        """Compute total cost and constraints with their derivatives."""
        q = self.path(x)
        cost, first, second = self._slopes.edge_slopes(q[:-1], q[1:])
        gradient = self._to_white @ (second[:-1] + first[1:])
        tied = np.bincount(self._tie_row, self._tie_entry * x[self._tie_column], len(self._tied_to))
        values, entries = [tied], [self._tie_entry]
        if len(self._edge):
            share = self._share[:, None]
            clearance, slope = self._clearance((1.0 - share) * q[self._edge] + share * q[self._edge + 1])
            ends = _COARSE * np.stack([(1.0 - share) * slope, share * slope], axis=1)
            values, entries = [clearance, tied], [ends[self._inner].ravel(), self._tie_entry]
        return Values(
            float(cost.sum()),
            np.append(np.zeros(gradient.size), gradient.ravel()),
            np.concatenate(values),
            np.concatenate(entries),
        )

    def _clearance(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]]:
        """Return the clearance and its gradient in units of the constraints."""
        known = self._slopes.clearance_slopes(q)
        assert known is not None  # otherwise there are no places with clearance constraints
        value = known[0] / _UNIT
        return np.minimum(value, _FAR), np.where(value[:, None] < _FAR, known[1], 0.0) / _UNIT

    def _choose_places(self, q: Float[Array, "point nq"], spacing: float) -> None:
        """Choose the places of clearance constraints: all inner points, and points along the edges."""
        pieces = np.maximum(1, np.ceil(np.linalg.norm(np.diff(q, axis=0), axis=1) / spacing)).astype(int)
        if self._slopes.clearance_slopes(self._ends) is None:
            pieces[:] = 0
        edge = np.repeat(np.arange(len(pieces)), pieces)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[edge]
        inside = edge + share > 0.0
        self._edge: Int[Array, " row"] = edge[inside]
        self._share: Float[Array, " row"] = share[inside]
        end = self._edge[:, None] + np.arange(2)
        # The first and the last point do not move; a place at a vertex depends only on this vertex.
        moves = (end > 0) & (end <= self._n) & ((self._share[:, None] > 0.0) | (np.arange(2) == 0))
        self._inner: Bool[Array, "row end"] = moves
        row, which = np.nonzero(moves)
        column = (self._edge[row] + which - 1)[:, None] * self._nq + np.arange(self._nq)
        self._place_pattern = Pattern(np.repeat(row, self._nq), column.ravel())

    def _tie(self, factor: Float[Array, "n n"], inner: Float[Array, "n nq"]) -> None:
        """Set up the equations that tie whitened variables to points: L^T q - x = L^T q_0."""
        n, nq = self._n, self._nq
        point = np.repeat(np.arange(n), nq)
        row = np.arange(n * nq)
        later = point < n - 1
        own, next_to = factor[point, point], factor[np.minimum(point + 1, n - 1), point]
        self._tie_row = np.concatenate([row, row[later], row])
        self._tie_column = np.concatenate([row, row[later] + nq, row + n * nq])
        self._tie_entry = np.concatenate([_COARSE * own, _COARSE * next_to[later], -np.ones(n * nq)])
        self._tied_to = (factor.T @ inner).ravel()
        places = self._place_pattern
        self.jacobian_pattern = Pattern(
            np.concatenate([places.row, self._tie_row + len(self._edge)]),
            np.concatenate([places.column, self._tie_column]),
        )

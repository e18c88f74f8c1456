"""Derivatives of edge costs: exact if the objective provides them, else by finite differences in one batch.

`Slopes` evaluates them for optimisers in slices that can be interrupted.
"""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.planners.interruptible import InterruptibleProblem, checked_costs
from graceful_plan.planners.planner import BoundObjective, Budget, DifferentiableObjective, Problem, edge_totals

DIFFERENCE = 0.02
"""Displacement of the ends of edges for central differences [rad].

It is wide since costs are noisy on a small scale: differences detect a jump of the impact only if they are about as
wide as the spacing of samples along an edge, and the cost of an edge jumps when its number of samples changes."""


def edge_derivatives(
    objective: BoundObjective,
    q0: Float[Array, "n nq"],
    q1: Float[Array, "n nq"],
    difference: float = DIFFERENCE,
) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
    """Return the total cost V + w S of each edge, and its derivatives with respect to `q0` and `q1`.

    Args:
        objective: Objective of edges.
        q0: Start of each edge.
        q1: End of each edge.
        difference: Displacement of each joint if the objective has no derivatives [rad].
    """
    if isinstance(objective, DifferentiableObjective):
        known = objective.edge_gradients(q0, q1)
        if known is not None:
            cost, d_q0, d_q1 = known
            return cost[:, 0] + objective.w * cost[:, 1], d_q0, d_q1
    return _differences(objective, q0, q1, difference)


def _differences(
    objective: BoundObjective, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], difference: float
) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
    """Compute central differences: each joint of each end is moved to both sides, in one batch with the edges."""
    n, nq = q0.shape
    move = np.zeros((4 * nq + 1, 2, nq))
    rows, joints = np.arange(nq), np.arange(nq)
    for end in (0, 1):
        for k, sign in ((0, 1.0), (1, -1.0)):
            move[(2 * end + k) * nq + rows, end, joints] = sign * difference
    first, second = q0 + move[:, None, 0], q1 + move[:, None, 1]
    cost = edge_totals(objective, first.reshape(-1, nq), second.reshape(-1, nq)).reshape(4 * nq + 1, n)
    up0, down0, up1, down1 = cost[:-1].reshape(4, nq, n)
    return cost[-1], (up0 - down0).T / (2.0 * difference), (up1 - down1).T / (2.0 * difference)


@final
class Slopes(InterruptibleProblem):
    """`InterruptibleProblem` with derivatives.

    Args:
        problem: Problem for collision checks and clearances.
        objective: Objective for costs.
        budget: Budget whose time limit and cancellation interrupt.
        difference: Displacement for objectives without derivatives; see `edge_derivatives`.
    """

    def __init__(
        self, problem: Problem, objective: BoundObjective, budget: Budget, difference: float = DIFFERENCE
    ) -> None:
        super().__init__(problem, objective, budget)
        self._difference = difference

    def edge_slopes(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return the total cost of each edge and its derivatives with respect to `q0` and `q1`.

        Raises:
            CostError: If the objective returns a NaN, an infinity or a negative number.
        """
        nq = q0.shape[1]
        rows = self._sliced("edge_slopes", self._edge_slopes, q0, q1).reshape(len(q0), 1 + 2 * nq)
        return rows[:, 0], rows[:, 1 : 1 + nq], rows[:, 1 + nq :]

    def clearance_slopes(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]] | None:
        """Return the clearance beyond the margin, and its gradient; None if the problem does not provide it."""
        return self.problem.clearance_gradient(q)

    def _edge_slopes(self, q0: Array, q1: Array) -> Array:
        cost, d_q0, d_q1 = edge_derivatives(self.objective, q0, q1, self._difference)
        checked_costs(self.objective, "edge costs", cost)
        return np.concatenate([cost[:, None], d_q0, d_q1], axis=1)

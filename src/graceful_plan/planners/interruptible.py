"""Interruptible evaluation of problem and objective in slices.

A planner that evaluates thousands of edges at once must still stop within milliseconds when its time is over or the
call is cancelled, even with a slow custom cost. `InterruptibleProblem` cuts every batch into slices and raises
`Interrupted` between two of them; `solve` methods end on it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.exceptions import CostError
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Problem, edge_totals

_SLICE_SECONDS = 0.005
_FIRST_SLICE = 16
_FIXED_SLICE = 512


class Interrupted(Exception):
    """Raised inside a planner when the time is over or the call is cancelled; not an error."""


def out_of_time(budget: Budget) -> bool:
    """Return whether to stop within an iteration: the time is over or the call is cancelled."""
    return budget.elapsed >= budget.time_limit or budget.cancelled()


def checked_costs(objective: BoundObjective, what: str, costs: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return costs after checking that they are finite and not negative.

    Raises:
        CostError: If they are not.
    """
    if not np.all(np.isfinite(costs) & (costs >= 0.0)):
        raise CostError(objective, f"{what} must be finite and >= 0")
    return costs


class InterruptibleProblem:
    """Evaluates problem and objective in slices of some milliseconds.

    Without a time limit the size of slices is fixed, so that results do not depend on the speed of the machine.

    Args:
        problem: Problem for collision checks.
        objective: Objective for costs.
        budget: Budget whose time limit and cancellation interrupt.
    """

    def __init__(self, problem: Problem, objective: BoundObjective, budget: Budget) -> None:
        self.problem, self.objective, self.budget = problem, objective, budget
        self._timed = np.isfinite(budget.time_limit)
        self._sizes: dict[str, int] = {}

    def states_free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return which configurations are inside the limits and free."""
        inside = np.all((q >= self.problem.lower) & (q <= self.problem.upper), axis=1)
        inside[inside] = self._sliced("states_free", self.problem.states_free, q[inside]).astype(bool)
        return inside

    def state_costs(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the weighted impact w I(q) of each configuration.

        Raises:
            CostError: If the objective returns a NaN, an infinity or a negative number.
        """
        return self._sliced("states", self._weighted_impact, q)

    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return which edges are free."""
        return self._sliced("edges_free", self.problem.edges_free, q0, q1).astype(bool)

    def edge_costs(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the total cost V + w S of each edge.

        Raises:
            CostError: If the objective returns a NaN, an infinity or a negative number.
        """
        return self._sliced("edges", self._totals, q0, q1)

    def edge_free(self, q0: Float[Array, " nq"], q1: Float[Array, " nq"]) -> bool:
        """Return whether one edge is free, without checking the budget."""
        return bool(self.problem.edges_free(q0[None], q1[None])[0])

    def state_cost(self, q: Float[Array, " nq"]) -> float:
        """Return the weighted impact of one configuration, without checking the budget."""
        return float(self._weighted_impact(q[None])[0])

    def path_cost(self, path: Path) -> float:
        """Return the total cost of a path, uninterrupted, so that a path found at the last moment is not lost.

        Raises:
            CostError: As for `edge_costs`.
        """
        return float(self._totals(path.q[:-1], path.q[1:]).sum())

    def _totals(self, q0: Array, q1: Array) -> Array:
        return checked_costs(self.objective, "edge costs", edge_totals(self.objective, q0, q1))

    def _weighted_impact(self, q: Array) -> Array:
        if self.objective.w == 0.0:
            return np.zeros(len(q))
        return self.objective.w * checked_costs(self.objective, "state costs", self.objective.states(q))

    def _sliced(self, kind: str, ask: Callable[..., Array], *arrays: Array) -> Array:
        answers, begin, n = [], 0, len(arrays[0])
        size = self._sizes.get(kind, _FIRST_SLICE) if self._timed else _FIXED_SLICE
        while begin < n:
            if out_of_time(self.budget):
                raise Interrupted
            before = time.perf_counter()
            answers.append(np.asarray(ask(*(a[begin : begin + size] for a in arrays))))
            begin += size
            if self._timed:
                size = _next_size(size, time.perf_counter() - before)
        self._sizes[kind] = size
        return np.concatenate(answers) if answers else np.zeros(0)


def _next_size(size: int, seconds: float) -> int:
    if seconds > _SLICE_SECONDS:
        return max(1, size // 2)
    return size * 2 if seconds < 0.4 * _SLICE_SECONDS and size < 1 << 16 else size

"""Questions to the problem and the objective, in slices that can be interrupted.

A planner that asks about thousands of edges at once must still stop within milliseconds when its time is over or
somebody cancels, however slow a user's cost is. `Questions` cuts every batch into slices and raises `Interrupted`
between two of them; `solve` methods end on it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.exceptions import CostError
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Problem, edge_totals

Array = np.ndarray

_SLICE_SECONDS = 0.005
_FIRST_SLICE = 16
_FIXED_SLICE = 512


class Interrupted(Exception):
    """The time is over or somebody cancelled: a signal between the functions of one planner, not an error."""


def out_of_time(budget: Budget) -> bool:
    """Whether to stop in the middle of an iteration; iterations that were spent may be finished."""
    return budget.elapsed >= budget.time_limit or budget.cancelled()


def checked_costs(objective: BoundObjective, what: str, costs: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return costs that are finite and not negative.

    Raises:
        CostError: If they are not.
    """
    if not np.all(np.isfinite(costs) & (costs >= 0.0)):
        raise CostError(objective, f"{what} must be finite and >= 0")
    return costs


class Questions:
    """Asks in slices, each sized to take some milliseconds.

    Without a time limit the size is fixed, so that a result cannot depend on how fast the machine was.

    Args:
        problem: Which states and edges are free.
        objective: What edges cost.
        budget: Whose time counts.
    """

    def __init__(self, problem: Problem, objective: BoundObjective, budget: Budget) -> None:
        self.problem, self.objective, self.budget = problem, objective, budget
        self._timed = np.isfinite(budget.time_limit)
        self._sizes: dict[str, int] = {}

    def states_free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Tell which configurations are inside the limits and free."""
        inside = np.all((q >= self.problem.lower) & (q <= self.problem.upper), axis=1)
        inside[inside] = self._sliced("states_free", self.problem.states_free, q[inside]).astype(bool)
        return inside

    def state_costs(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Weighted impact w I(q).

        Raises:
            CostError: If the objective returns a NaN, an infinity or a negative number.
        """
        return self._sliced("states", self._weighted_impact, q)

    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Tell which edges are free."""
        return self._sliced("edges_free", self.problem.edges_free, q0, q1).astype(bool)

    def edge_costs(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Total cost V + w S of each edge.

        Raises:
            CostError: If the objective returns a NaN, an infinity or a negative number.
        """
        return self._sliced("edges", self._totals, q0, q1)

    def edge_free(self, q0: Float[Array, " nq"], q1: Float[Array, " nq"]) -> bool:
        """Tell whether one edge is free, without a look at the clock."""
        return bool(self.problem.edges_free(q0[None], q1[None])[0])

    def state_cost(self, q: Float[Array, " nq"]) -> float:
        """Weighted impact of one configuration, without a look at the clock."""
        return float(self._weighted_impact(q[None])[0])

    def path_cost(self, path: Path) -> float:
        """Total cost of a path, asked in one piece so that a path found in the last moment is not lost.

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

"""Interface of planners: problem, objective, budget and planner.

A planner is a frozen settings object with one method, `solve`. It checks states and edges with a `Problem` and
evaluates edges with a `BoundObjective`, both in batches, and yields paths of decreasing cost. `graceful_plan.plan`
handles time limit, cancellation, progress and trace for all planners, on top of `Budget`.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, final, runtime_checkable

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.path import Path


class Problem(ABC):
    """A planning problem: start, goals, limits, and collision checks of states and edges."""

    start: Float[Array, " nq"]
    goals: Float[Array, "goal nq"]
    lower: Float[Array, " nq"]
    upper: Float[Array, " nq"]

    @property
    def extent(self) -> float:
        """Length of the diagonal of the limits [rad]."""
        return float(np.linalg.norm(self.upper - self.lower))

    @abstractmethod
    def states_free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return which configurations are free of collision; the planner itself has to keep the limits."""

    @abstractmethod
    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return which straight edges from `q0` to `q1` are free of collision."""

    def projected(self, q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Project configurations onto the constraints as far as possible; the default returns them unchanged.

        Planners use it since random samples hardly ever satisfy thin constraints.
        """
        return q

    def clearance_gradient(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]] | None:
        """Return the clearance beyond the margin [m], and its gradient; None, the default, if it is not available.

        It is positive if a configuration is free and negative if it is not; near 0 it is a distance. Optimisers use it
        to move paths out of collision.
        """
        del q
        return None


@runtime_checkable
class BoundObjective(Protocol):
    """The cost J = V + w S of a planner: additive over edges, never negative."""

    @property
    def w(self) -> float:
        """Safety weight."""
        ...

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        """Return motion cost V and impact S of each straight edge, travelled from `q0` to `q1`."""
        ...

    def states(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the impact of a failure in each configuration, at rest."""
        ...


@runtime_checkable
class DifferentiableObjective(BoundObjective, Protocol):
    """An objective with derivatives."""

    def edge_gradients(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]
    ) -> tuple[Float[Array, "n 2"], Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return `edges`, and the derivatives of V + w S with respect to `q0` and `q1`; None if there are none."""
        ...


@runtime_checkable
class WidenableObjective(BoundObjective, Protocol):
    """An objective whose impact can be blurred in space, so that a descent has a gradient farther from entities."""

    def widened(self, metres: float) -> BoundObjective | None:
        """Return the objective with places of impact blurred by `metres` more; None if that is not possible."""
        ...


def edge_totals(objective: BoundObjective, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, " n"]:
    """Return the total cost V + w S of each edge."""
    cost = objective.edges(q0, q1)
    return cost[:, 0] + objective.w * cost[:, 1]


def path_total(objective: BoundObjective, path: Path) -> float:
    """Return the total cost V + w S of a path."""
    return float(edge_totals(objective, path.q[:-1], path.q[1:]).sum())


@final
@dataclass
class Budget:
    """Budget of a planner: a time limit, a number of iterations, and a test for cancellation.

    With `iterations` set and no time limit, a planner's result depends only on its seed.
    """

    time_limit: float = np.inf
    """Time limit from `started` on [s]."""
    iterations: int | None = None
    """Planner iterations, as each planner defines them; None: unlimited."""
    cancelled: Callable[[], bool] = field(default=lambda: False)
    spent: int = field(default=0, init=False)
    started: float = field(default_factory=time.perf_counter)
    """Clock reading [s] at which the budget began."""

    @property
    def elapsed(self) -> float:
        """Time since `started` [s]."""
        return time.perf_counter() - self.started

    @property
    def remaining_seconds(self) -> float:
        """Remaining time [s], at least 0."""
        return max(0.0, self.time_limit - self.elapsed)

    @property
    def remaining_iterations(self) -> float:
        """Remaining iterations; infinite if they are not limited."""
        return np.inf if self.iterations is None else float(max(0, self.iterations - self.spent))

    @property
    def timed(self) -> bool:
        """Whether only time limits the effort; with `iterations`, a time limit only stops early."""
        return self.iterations is None and bool(np.isfinite(self.time_limit))

    @property
    def exhausted(self) -> bool:
        """Whether time or iterations are used up, or the call is cancelled."""
        return self.remaining_iterations <= 0 or self.over

    @property
    def over(self) -> bool:
        """Whether the time is used up or the call is cancelled; long iterations check this between their steps."""
        return self.elapsed >= self.time_limit or self.cancelled()

    def is_late(self, part: float) -> bool:
        """Return whether more than a fraction `part` of the time limit is used up."""
        return self.elapsed > part * self.time_limit

    def spend(self, n: int = 1) -> bool:
        """Count `n` iterations and return True; return False if the budget is exhausted."""
        if self.exhausted:
            return False
        self.spent += n
        return True

    @contextmanager
    def share(
        self,
        seconds: float = np.inf,
        iterations: int | float = np.inf,
        *,
        until: Callable[[], bool] = lambda: False,
    ) -> Generator[Budget]:
        """Provide a part of the remaining budget as a separate budget, for a `with` block.

        Both budgets have the same clock. Iterations of the part are added to this budget when the block ends, also
        after an exception; do not spend this budget inside the block.

        Args:
            seconds: Largest time of the part [s].
            iterations: Largest number of iterations of the part, rounded up; unlimited if this and the budget are.
            until: Cancels the part once it returns True.
        """
        granted = min(max(0.0, iterations), self.remaining_iterations)
        part = Budget(
            time_limit=min(self.time_limit, self.elapsed + max(0.0, seconds)),
            iterations=None if np.isinf(granted) else int(np.ceil(granted)),
            cancelled=lambda: self.cancelled() or until(),
            started=self.started,
        )
        try:
            yield part
        finally:
            self.spent += part.spent


class Planner(ABC):
    """Base class of all planners: a frozen dataclass of settings with one method."""

    name: ClassVar[str]
    """Name that selects the planner in `plan(planner=...)`."""
    anytime: ClassVar[bool]
    """Whether the planner improves its solution until the budget ends."""
    drives: ClassVar[bool] = False
    """Whether the planner is for mobile bases that roll along their heading, and only for these."""

    @abstractmethod
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths from the start to one of the goals, each of lower total cost than the previous one.

        Start and goals are free and inside the limits. An implementation calls `budget.spend()` once per iteration and
        returns when that is False; an iteration may take at most about 20 ms. It yields nothing if it finds no path. It
        is deterministic for a given `rng` if only iterations limit the budget.
        """

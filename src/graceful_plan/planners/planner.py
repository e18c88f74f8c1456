"""The planner contract: what a planner sees, what it yields, and the budget it lives on.

A planner is a frozen settings object with one method, `solve`. It sees the world through two batched
questions (`Problem`) and the cost through one (`BoundObjective`), and yields better and better paths.
Time limit, cancellation, progress and trace are handled once, by `graceful_plan.plan`, on top of `Budget`.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, final, runtime_checkable

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.path import Path

Array = np.ndarray


class Problem(ABC):
    """A start, one or more goals, limits, and which states and edges are free."""

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
        """Tell which configurations are free of collision. Limits are the planner's business."""

    @abstractmethod
    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Tell which straight edges from `q0` to `q1` are free of collision."""

    def projected(self, q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        """Return configurations moved to where constraints hold, as far as that is possible; as they are by default.

        Samples that are drawn among thin constraints hardly ever keep them.
        """
        return q

    def clearance_gradient(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]] | None:
        """Return the clearance beyond what has to be kept, and its gradient; None, the default, if it is not known.

        Positive where a configuration is free, negative where it is not, and a distance near the border: optimisers
        push paths away by it.
        """
        del q
        return None


@runtime_checkable
class BoundObjective(Protocol):
    """What a planner sees of the cost J = V + w S: additive over edges, never negative."""

    @property
    def w(self) -> float:
        """Safety weight."""
        ...

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        """Motion cost V and impact S of each straight edge, travelled from `q0` to `q1`."""
        ...

    def states(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Impact given that the robot fails right there, at rest."""
        ...


@runtime_checkable
class DifferentiableObjective(BoundObjective, Protocol):
    """A cost that knows its derivatives."""

    def edge_gradients(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]
    ) -> tuple[Float[Array, "n 2"], Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """`edges`, and the derivatives of V + w S of each edge with respect to `q0` and `q1`; None if it has none."""
        ...


@runtime_checkable
class WidenableObjective(BoundObjective, Protocol):
    """A cost whose hazards can be smeared, so that a descent feels them from afar."""

    def widened(self, metres: float) -> BoundObjective | None:
        """Return the same with hits smeared by so much more; None if it has no such form."""
        ...


def edge_totals(objective: BoundObjective, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, " n"]:
    """Total cost V + w S of each edge."""
    cost = objective.edges(q0, q1)
    return cost[:, 0] + objective.w * cost[:, 1]


def path_total(objective: BoundObjective, path: Path) -> float:
    """Total cost V + w S of a path."""
    return float(edge_totals(objective, path.q[:-1], path.q[1:]).sum())


@final
@dataclass
class Budget:
    """What a planner may still spend: seconds, iterations, or until somebody cancels.

    With `iterations` set and no time limit, a planner's result depends on its seed alone.
    """

    time_limit: float = np.inf
    """Seconds from construction on."""
    iterations: int | None = None
    """Planner iterations; each planner documents what one of its iterations is."""
    cancelled: Callable[[], bool] = field(default=lambda: False)
    spent: int = field(default=0, init=False)
    started: float = field(default_factory=time.perf_counter)
    """Clock reading [s] at which the budget began."""

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.started

    @property
    def remaining_seconds(self) -> float:
        """Seconds left, at least 0."""
        return max(0.0, self.time_limit - self.elapsed)

    @property
    def remaining_iterations(self) -> float:
        """Iterations left, infinite if they are not limited."""
        return np.inf if self.iterations is None else float(max(0, self.iterations - self.spent))

    @property
    def timed(self) -> bool:
        """Whether time alone says when there was enough effort; with iterations, a time limit only ends it early."""
        return self.iterations is None and bool(np.isfinite(self.time_limit))

    @property
    def exhausted(self) -> bool:
        """Whether nothing is left or somebody cancelled."""
        return self.remaining_iterations <= 0 or self.over

    @property
    def over(self) -> bool:
        """Whether the time is up or somebody cancelled: what an iteration that takes long asks on the way."""
        return self.elapsed >= self.time_limit or self.cancelled()

    def is_late(self, part: float) -> bool:
        """Tell whether more than a part of the time is over."""
        return self.elapsed > part * self.time_limit

    def spend(self, n: int = 1) -> bool:
        """Count `n` iterations; return whether there was budget for them."""
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
        """Hand out a part of what is left as a budget of its own, for a `with` block.

        The clock of the part is that of the whole. What the part spends counts here when the block ends, however it
        ends; this budget itself is not to be spent in the meantime.

        Args:
            seconds: At most so many of those left [s].
            iterations: At most so many of those left, rounded up; none are counted out if they are not limited at all.
            until: Endpoints the part as if somebody cancelled it.
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
    """Base of all planners: a frozen dataclass of settings with one method."""

    name: ClassVar[str]
    """The word that selects it in `plan(planner=...)`."""
    anytime: ClassVar[bool]
    """Whether it keeps improving its solution until the budget ends."""
    drives: ClassVar[bool] = False
    """Whether it plans for bases that roll along their heading, and for these alone."""

    @abstractmethod
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths from the start to one of the goals, each of lower total cost than the one before.

        Start and goals are free and inside the limits. An implementation checks `budget.spend()` once per
        iteration and returns when it says no; no single iteration may take longer than about 20 ms.
        Yielding nothing means that no path was found. Deterministic for a given `rng` when the budget is
        given in iterations.
        """

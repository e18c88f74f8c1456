"""The default planner: several anytime searches in parallel, which exchange their best path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array
from graceful_plan.core import _native
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.anytime.anytime import Anytime
from graceful_plan.planners.native import native_space
from graceful_plan.planners.optimisers.optimiser import joined_to_ends
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.setting_checks import count

_ROUND_SECONDS = 0.01
"""Time between two exchanges [s]."""
_ROUND_ITERATIONS = 64
"""Iterations between two exchanges without a time limit; exchanges then must not depend on the clock."""
_FIRST_SECONDS = 0.004
"""Time for which the first search runs alone [s]; it usually finds the first path earlier."""
_WORTH_TELLING = 1e-3
"""Relative gain from which on the other searches adopt a path."""


@final
@dataclass(frozen=True, kw_only=True)
class Auto(Planner):
    """Improves its path until the budget ends, or until it is proven optimal.

    One iteration is one of `Anytime`, in any of the searches. The searches run in separate threads if the whole
    objective is native and w > 0; otherwise there is one search.

    Args:
        initial: Initial guess: a path or an array of configurations; see `Optimiser`. It need not be free.
        workers: Number of searches. The result depends on it, but not on the number of cores.
        search: Settings of each search.
    """

    name: ClassVar[str] = "auto"
    anytime: ClassVar[bool] = True

    initial: Path | Array | None = None
    workers: int = 2
    search: Anytime = field(default_factory=Anytime)

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("workers", self.workers)
        if not isinstance(self.search, Anytime):
            raise SettingError("search", self.search, "an Anytime")
        if not isinstance(self.initial, Path | Array | None):
            raise SettingError("initial", self.initial, "a Path, an array of configurations or None")

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost."""
        space = native_space(problem, objective)
        native = isinstance(objective, SceneObjective) and objective.kernel is not None
        several = native and isinstance(space, _native.SceneSpace) and objective.w > 0.0
        cores = [self.search.search(space, problem, rng) for _ in range(self.workers if several else 1)]
        if self.initial is not None:
            yield from _begin(cores, joined_to_ends(self.initial, problem), problem)
        best = min(core.total for core in cores)
        with ExitStack() as stack:
            pool = stack.enter_context(ThreadPoolExecutor(len(cores))) if len(cores) > 1 else None
            active = cores[:1]
            while not budget.exhausted and not any(core.optimal for core in cores):
                _work(active, pool, budget, _FIRST_SECONDS if active is not cores else _ROUND_SECONDS)
                active = cores
                winner = min(cores, key=lambda core: core.total)
                if winner.total < best:
                    best = winner.total
                    path = winner.path
                    yield Path(path)
                    for core in cores:
                        if core.total > best * (1.0 + _WORTH_TELLING):
                            core.adopt(path)


def _begin(cores: list[_native.Anytime], initial: Path, problem: Problem) -> Iterator[Path]:
    """Give all searches an initial guess, clamped to the limits; if it is free, adopt and yield it."""
    q = np.ascontiguousarray(Path(np.clip(initial.q, problem.lower, problem.upper)).without_duplicates().q)
    free = cores[0].admits(q)
    for core in cores:
        if free:
            core.adopt(q)
        core.suggest(q)
    if free:
        yield Path(q)


def _work(cores: list[_native.Anytime], pool: ThreadPoolExecutor | None, budget: Budget, seconds: float) -> None:
    """Run the searches for one round of the budget; at most as many searches as there are remaining iterations."""
    cores = cores[: int(min(len(cores), budget.remaining_iterations))]
    if not cores:  # the time ran out or the call was cancelled a moment ago
        return
    timed = budget.iterations is None or np.isfinite(budget.time_limit)
    share = budget.remaining_iterations / len(cores)
    iterations = int(min(np.inf if timed else _ROUND_ITERATIONS, max(1.0, share), 1e6))
    limit = min(seconds, budget.remaining_seconds) if timed else np.inf

    def run(core: _native.Anytime) -> int:
        return core.run(iterations, limit)[1]

    work: Callable[..., object] = map if pool is None or len(cores) == 1 else pool.map
    budget.spent += sum(work(run, cores))

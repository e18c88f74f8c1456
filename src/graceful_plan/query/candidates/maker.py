"""The contract of what makes motions for a request, from one problem."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from graceful_plan.planners.planner import Budget
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.candidates.search import Search


@runtime_checkable
class MotionMaker(Protocol):
    """Makes motions, each timed and with its cost, none of them verified."""

    @property
    def path_cost(self) -> float:
        """Least cost of a path of a search, as the search estimates it."""
        ...

    @property
    def restarts(self) -> bool:
        """Whether there are rounds, each longer than the one before; else there is one."""
        ...

    @property
    def effort(self) -> int:
        """Number of descents that have ended."""
        ...

    def search_first(self, budget: Budget) -> Search:
        """Search until there is a path; return the search."""
        ...

    def first(self, budget: Budget) -> Iterator[Motion]:
        """Yield motions near the first path.

        Raises:
            RetimingError: If the path has no timing.
        """
        ...

    def round(self, budget: Budget, best: float) -> Iterator[Motion]:
        """Yield motions of one round, those that are ranked before the best one known."""
        ...

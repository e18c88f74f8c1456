"""Interface of objects that make motions for a request."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol, runtime_checkable

from graceful_plan.array_types import Array, Float
from graceful_plan.planners.planner import Budget
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.candidates.search import Search


@runtime_checkable
class MotionMaker(Protocol):
    """Makes motions for one problem; motions are timed and have a cost, but are not verified."""

    @property
    def path_cost(self) -> float:
        """Least estimated cost of a path that the searches have found."""
        ...

    @property
    def restarts(self) -> bool:
        """Whether there are rounds of doubling length, each with a new search; if False, there is one round."""
        ...

    @property
    def effort(self) -> int:
        """Number of descents that have ended."""
        ...

    def search_first(self, budget: Budget) -> Search:
        """Search until there is a path; return the result of the search."""
        ...

    def first(self, budget: Budget) -> Iterator[Motion]:
        """Yield motions near the first path.

        Raises:
            RetimingError: If the path cannot be timed.
        """
        ...

    def round(self, budget: Budget, best: float) -> Iterator[Motion]:
        """Yield motions of one round that are ranked before the best-known one, whose ranking is `best`."""
        ...

    def others(self, is_new: Callable[[Float[Array, "n nq"]], bool]) -> Iterator[Motion]:
        """Yield motions along curves of earlier descents, by increasing estimated cost.

        Args:
            is_new: Whether a curve is worth timing, by its samples.
        """
        ...

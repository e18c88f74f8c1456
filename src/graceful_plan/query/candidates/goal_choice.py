"""Choice among several goals: a quick motion to each shows which goals are worth a search.

A search for all goals at once stays near the goal that it reaches first, which may be far from the best one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Protocol, final

import numpy as np

from graceful_plan.exceptions import RetimingError
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.motions import Motion, with_cost
from graceful_plan.query.candidates.search import Search
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.query.request import Request


class QuickSource(Protocol):
    """Finds a path to a single goal, and motions near it."""

    def search_first(self, budget: Budget) -> Search:
        """Search until there is a path."""
        ...

    def first(self, budget: Budget) -> Iterator[Motion]:
        """Yield motions near the first path."""
        ...


@final
class GoalChoice:
    """Finds a short motion to each goal, and chooses goals for searches.

    Args:
        request: The request.
        problem: Problem with all goals.
        source: Makes a source of motions for a request and a problem.
    """

    def __init__(
        self, request: Request, problem: SceneProblem, source: Callable[[Request, SceneProblem], QuickSource]
    ) -> None:
        self._request, self._problem = request, problem
        objective = request.objective
        shortest = replace(objective.objective, w=0.0).bind(objective.scene, objective.paces)
        self._source = partial(source, replace(request, objective=shortest))
        self._straight = Travel(problem.start, objective).cost(problem.goals)
        self._pending = deque(np.argsort(self._straight, kind="stable").tolist())
        self._ranking: dict[int, float] = {}
        """The least ranking of a motion to each goal that was reached."""
        self._searches = np.zeros(len(problem.goals), dtype=int)

    def motions(self, budget: Budget, best: float) -> Iterator[Motion]:
        """Yield a short motion to each goal, the nearest goals first, until the budget ends.

        Args:
            budget: Budget.
            best: Ranking of the best motion; goals whose straight motion costs more are left out.
        """
        while self._pending and not budget.exhausted:
            goal = self._pending[0]
            if self._straight[goal] < best:
                source = self._source(self._only(goal))
                if not source.search_first(budget).paths:
                    self._pending.rotate(-1)
                    return
                with suppress(RetimingError):
                    for short in islice(source.first(budget), 1):
                        motion = with_cost(short, self._request)
                        self.reach(goal, motion.ranking)
                        best = min(best, motion.ranking)
                        yield motion
            self._pending.popleft()

    def reach(self, goal: int, ranking: float) -> None:
        """Note a motion to a goal."""
        self._ranking[goal] = min(ranking, self._ranking.get(goal, np.inf))

    def problems(self, best: float) -> list[SceneProblem]:
        """Return the problem of all goals to which a motion may be better than `best`, and that of one of them.

        The one goal was reached before, and is another one in each call.
        """
        may = self._straight < best
        may[np.argmin(self._straight)] = True
        several = replace(self._problem, goals=self._problem.goals[may])
        reached = [goal for goal in self._ranking if may[goal]]
        if not reached or may.sum() == 1:
            return [several]
        one = min(reached, key=lambda goal: (self._searches[goal], self._ranking[goal]))
        self._searches[one] += 1
        return [several, self._only(one)]

    def _only(self, goal: int) -> SceneProblem:
        return replace(self._problem, goals=self._problem.goals[[goal]])

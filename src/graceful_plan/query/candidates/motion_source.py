"""Motions from paths: a search finds paths, descents turn them into smooth curves, and these are timed.

A search stays in one homotopy class. Only smooth timed motions show which class is the best, so each round begins a
new search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.anytime.auto import Auto
from graceful_plan.planners.descent_rounds import descend_from
from graceful_plan.planners.motion_descent import DescentResult, DescentSettings, Start
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.departure import search_with_moving_entities
from graceful_plan.query.candidates.descents import SHORTENING, motion_descents, start_along, start_of, start_onto
from graceful_plan.query.candidates.goal_choice import GoalChoice
from graceful_plan.query.candidates.motions import Motion, along, timed_curve, with_cost
from graceful_plan.query.candidates.proxy_objective import proxy_objective
from graceful_plan.query.candidates.search import Callback, PausedSearch, Search, subsampled
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request

_SEARCH_SHARE = 0.15
"""Share of a round for the search; the rest is for descents from its paths."""
_SPECIAL_SEARCH_SHARE = 0.7
"""Share of a round for searches that rank paths by a risk measure or departure time, which descents cannot do."""
_RELATED_SHARE, _RELATED_ALONE_SHARE = 0.65, 0.1
"""Share of a round for motions of a related objective; the second one if the full objective has no descents."""
_RELATED_KEPT = 2
"""Motions of a related objective that serve as starts of descents along the full one."""
_GOALS_SHARE = 0.15
"""Share of a round for quick motions to each of several goals."""
_STARTS = 5
"""Paths of a search that serve as starts of descents."""
_WORTH_TIMING = 1.1
"""Largest ratio of a curve's estimated J to the best J at which it is timed; estimates are off by some percent."""
_FIRST_DESCENT = 0.01
"""Time limit of the first descent of a cancelled call [s]."""


@final
class MotionSource:
    """Makes motions for a request; motions are timed and have a cost, but are not verified.

    Args:
        request: The request.
        ends: Both ends.
        problem: Problem to search.
        rng: Random numbers.
        tell: Called with improvements of a search whose paths are not refined; returns whether to end the search.
    """

    def __init__(
        self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator, tell: Callback
    ) -> None:
        self._request, self._ends, self._problem, self._rng = request, ends, problem, rng
        self._first = PausedSearch(request.planner, problem, request.objective, rng.spawn(1)[0])
        self._continues, self._tell = True, tell
        self.path_cost = np.inf
        """Least estimated cost of a path that the searches have found."""
        self._shortens = self.restarts and request.only_length
        settings = SHORTENING if self._shortens else DescentSettings()
        self._descents = motion_descents(request, problem, settings) if request.refine else None
        self._results: list[DescentResult] = []
        self._screened: list[DescentResult] | None = [] if request.candidates > 1 else None
        onward = None if request.takeover is None else request.takeover.onward
        self._onward = [] if onward is None else [start_onto(onward, ends)]
        self._rounds = 0
        self._goals: GoalChoice | None = None
        self._related: MotionSource | None = None
        related = proxy_objective(request.objective) if request.refine and request.preference is None else None
        if related is not None:
            self._related = MotionSource(replace(request, objective=related), ends, problem, rng, tell)
        elif len(problem.goals) > 1 and self.restarts:
            self._goals = GoalChoice(request, problem, lambda of, to: MotionSource(of, ends, to, rng, tell))

    @property
    def restarts(self) -> bool:
        """Whether each round begins a new search; if False, there is one search."""
        request = self._request
        default = isinstance(request.planner, Auto) and request.planner.initial is None
        return default and request.refine and request.preference is None and not request.objective.scene.moving

    @property
    def effort(self) -> int:
        """Number of descents that have ended."""
        own = 0 if self._descents is None else self._descents.effort.descents
        return own + (0 if self._related is None else self._related.effort)

    def search_first(self, budget: Budget) -> Search:
        """Search until there is a path; return the result of the search."""
        if self._related is not None:
            return self._related.search_first(budget)
        self._first.advance(budget, to_first=True)
        return self._first.found

    def first(self, budget: Budget) -> Iterator[Motion]:
        """Yield motions near the first path: a smooth one, then motions along the path itself.

        Raises:
            RetimingError: If the path cannot be timed.
        """
        if self._related is not None:
            yield from (with_cost(motion, self._request) for motion in self._related.first(budget))
            return
        path = self._first.found.paths[-1]

        def late() -> bool:
            return budget.remaining_seconds == 0.0

        if self._descents is not None and path.length > 0.0:
            # A cancelled call has no budget left, but the first descent takes a millisecond.
            limit = Budget(time_limit=_FIRST_DESCENT) if budget.cancelled() else budget
            result = self._descents.first(start_of(path, self._ends), limit)
            motion = None if result is None else timed_curve(result, self._request)
            if motion is not None:
                yield motion
            elif result is not None and late():
                return
        yield from along(path, self._request, self._ends, late)

    def round(self, budget: Budget, best: float) -> Iterator[Motion]:
        """Yield motions of one round; motions from descents only if ranked before the best-known one."""
        self._rounds += 1
        starts: list[Start] = []
        if self._goals is not None:
            share = _GOALS_SHARE
            with budget.share(share * budget.remaining_seconds, share * budget.remaining_iterations) as part:
                for motion in self._goals.motions(part, best):
                    best = min(best, motion.ranking)
                    starts.append(start_along(motion.path, motion.arrival, self._ends))
                    yield motion
        if self._related is not None:
            share = _RELATED_SHARE if self._descents is not None else _RELATED_ALONE_SHARE
            with budget.share(share * budget.remaining_seconds, share * budget.remaining_iterations) as part:
                motions = sorted(self._related.round(part, np.inf), key=_ranking)[:_RELATED_KEPT]
            for motion in motions:
                starts.append(start_along(motion.path, motion.arrival, self._ends))
                yield with_cost(motion, self._request)
        if self._related is None or not isinstance(self._request.objective.objective.impact, ImpactCost):
            found = self._search(budget, starts[0].path if self._related is not None and starts else None, best)
            if found.trace:
                self.path_cost = min(self.path_cost, found.trace[-1].total)
            paths = found.paths[-1:] if self._shortens else _spread(found.paths)
            starts += [*self._onward, *(start_of(path, self._ends) for path in paths)]
            self._onward = []
            if self._descents is None or not self.restarts:
                yield from self._along(found)
        if self._descents is not None:
            yield from self._descended(starts, budget, best)

    def others(self, is_new: Callable[[Float[Array, "n nq"]], bool]) -> Iterator[Motion]:
        """Yield motions along curves of earlier descents, by increasing estimated cost.

        Args:
            is_new: Whether a curve is worth timing, by its samples.
        """
        for result in sorted(self._results + (self._screened or []), key=_value):
            if is_new(result.curve.samples) and (motion := timed_curve(result, self._request)) is not None:
                yield motion
        if self._related is not None:
            yield from (with_cost(motion, self._request) for motion in self._related.others(is_new))

    def _descended(self, starts: list[Start], budget: Budget, best: float) -> Iterator[Motion]:
        assert self._descents is not None
        starts = [start for start in starts if start.path.length > 0.0]
        for result in descend_from(starts, self._descents, budget, self._rng, self._results, self._screened):
            self._results.append(result)
            if self._goals is not None:
                self._goals.reach(result.start.arrival, result.value)
            if result.value <= _WORTH_TIMING * min(best, *(other.value for other in self._results)):
                motion = timed_curve(result, self._request)
                if motion is not None and motion.ranking < best:
                    best = motion.ranking
                    yield motion

    def _along(self, found: Search) -> Iterator[Motion]:
        """Yield a motion along each of the last paths of a search, the best first."""
        for path in reversed(found.paths[-_STARTS:]):
            try:
                yield next(along(path, self._request, self._ends))
            except RetimingError:
                continue

    def _search(self, budget: Budget, initial: Path | None, best: float) -> Search:
        """Search for paths in a share of the budget, from an initial path if one is given."""
        request, problem, planner = self._request, self._problem, self._request.planner
        if request.preference is not None or request.objective.scene.moving:
            with budget.share(_SPECIAL_SEARCH_SHARE * budget.remaining_seconds) as part:
                if request.preference is not None:
                    return request.preference.search(planner, problem, part, self._rng)
                return search_with_moving_entities(request, problem, self._ends, part, self._rng)
        run = self._first
        if self._continues and self._shortens and budget.timed:
            self._continues = False
            return run.found  # a descent shortens the first path faster than the search would
        if initial is not None and isinstance(planner, Auto) and planner.initial is None:
            planner = replace(planner, initial=initial)
        problems = [problem] if self._goals is None else self._goals.problems(best)
        if self._shortens:
            problems = [problems[self._rounds % len(problems)]]
        runs = [run]
        if not self._continues or initial is not None or len(problems[0].goals) < len(problem.goals):
            runs = [PausedSearch(planner, one, request.objective, self._rng.spawn(1)[0]) for one in problems]
        self._continues = False
        share = (1.0 if self._descents is None else _SEARCH_SHARE) / len(runs)
        seconds, iterations = share * budget.remaining_seconds, budget.remaining_iterations / len(runs)
        for run in runs:
            with budget.share(seconds, iterations) as part:
                run.advance(part, None if self._request.refine else self._tell)
        found = runs[0].found
        for other in runs[1:]:
            found = replace(found, paths=[*other.found.paths[-1:], *found.paths])
        return found


def _spread(paths: list[Path]) -> list[Path]:
    """Return a subsample of the improvements of a search: the first, and increasingly dense towards the last."""
    if not paths:
        return []
    chosen = [*subsampled(len(paths))[: _STARTS - 1], 0]
    return [paths[k] for k in dict.fromkeys(chosen)]


def _ranking(motion: Motion) -> float:
    return motion.ranking


def _value(result: DescentResult) -> float:
    return result.value

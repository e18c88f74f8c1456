"""The way of an arm from its ends to a result."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np

from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.answers.outcome import failed, problems, solved, until_last_steps
from graceful_plan.query.cheaper import beginning_with, is_enough, known_motions
from graceful_plan.query.deadline.quick import quick_motions, wants_it_soon
from graceful_plan.query.departure import search_among_moving
from graceful_plan.query.ends import Ends
from graceful_plan.query.finish import first_verified
from graceful_plan.query.motions import along, motions
from graceful_plan.query.request import Request
from graceful_plan.query.restarts import search_for_motions
from graceful_plan.query.search import KEPT, Search
from graceful_plan.result import PlanResult

_NOT_FOR_CORNERS = frozenset(
    ("position_limits", "velocity_limits", "acceleration_limits", "consistency", "rest", "start", "goal", "cost")
)
"""What the judge may object to that it would also say of a motion which keeps nearer to the polyline."""


def searched_answer(request: Request, ends: Ends, budget: Budget, rng: np.random.Generator) -> PlanResult:
    """Search, time, judge, and search more cautiously for as long as the judge objects and the budget lasts."""
    found, refused, why_not, clock = Search(), None, "", request.clock
    stats: dict[str, float] = {}
    for problem in problems(request, ends):
        known = known_motions(request, problem, ends, budget, rng)
        asked = replace(request, planner=beginning_with(known, request))
        known_is_enough = bool(known) and request.preference is None and is_enough(request)
        found = Search() if known_is_enough else _searched(asked, problem, ends, budget, rng)
        stats = {"search_time": budget.elapsed, "iterations": float(budget.spent)}
        cancelled, first = budget.cancelled(), None
        soon = cancelled or wants_it_soon(found)
        if (found.paths or known) and (soon or clock.can_insure):
            quick = quick_motions(found, request, ends, problem, budget) if found.paths else ()
            first = first_verified(chain(known if cancelled or not found.paths else (), quick), request)
            # Now it is known what timing and judging take here.
            budget.time_limit = min(budget.time_limit, until_last_steps(request, budget.elapsed))
        judged = first if soon else None
        if judged is None or not judged.verdict.passed:
            candidates, why_not = motions(found, request, ends, problem, (budget, rng), known)
            judged = first_verified(candidates, request) or judged
        for path in reversed(found.paths[-KEPT:]):
            if judged is None or not set(judged.verdict.failures) - _NOT_FOR_CORNERS:
                break
            judged = first_verified(along(path, request, ends, swift=False), request) or judged
        if first is not None and first.verdict.passed and (judged is None or not judged.verdict.passed):
            judged = first
        if judged is not None and judged.verdict.passed:
            return solved(judged, (found, ends), request, budget, stats)
        refused = refused or judged
        if budget.exhausted or found.stopped or not (found.paths or found.refused or known):
            break
    return failed((found, ends), refused, why_not, budget, stats)


def _searched(request: Request, problem: SceneProblem, ends: Ends, budget: Budget, rng: np.random.Generator) -> Search:
    """Search by J; by a measure of risk or at the times of what moves where these decide."""
    if request.preference is not None:
        return request.preference.search(request.planner, problem, budget, rng, request.callback)
    if request.objective.scene.moving:
        return search_among_moving(request, problem, ends, budget, rng)
    return search_for_motions(request, problem, budget, rng)

"""The way of a base from its ends to a result: search, a motion soon, curves near what was found, and the judge.

What is returned costs no more, by J, than what a call with a weight of 0 has: see `candidates`; unless the callback
stopped the search, and so what would take longer than that did.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from graceful_plan.mobile.among.searching import search_among_walkers
from graceful_plan.mobile.motions.postures import BASE
from graceful_plan.mobile.query.candidates import Drives, Ordinary
from graceful_plan.mobile.query.clock import Clock, paces_of
from graceful_plan.mobile.query.last_steps import (
    failed,
    first_verified,
    problems,
    solved,
    until_last_steps,
    wants_it_soon,
)
from graceful_plan.mobile.query.tight import rolling_endpoints
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.candidates.search import ALL, Callback, Search, search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.query.verification import Judged
from graceful_plan.result import PlanResult, TracePoint

_SHARE, _ARM_SHARE = 0.5, 0.3
"""Of the time, for the search of a base's path, of one without and with an arm or among those who move; the rest is for
curves near it."""
_CLOSE = 1.1
"""How much more a motion may cost by a close estimate so that it is charged in full before it is dropped."""
_ORDINARY_SHARE = 0.25
"""Of the time and of the iterations, for the search by a weight of 0 before: it is quick, for nothing but walls is
looked at."""
_MOTIONS_SHARE = 0.7
"""Of the time that is left after the search, for motions: the last curve and its laws of time end late, and what is not
judged in time is not had."""


def driven_answer(request: Request, ends: Endpoints, budget: Budget, rng: np.random.Generator) -> PlanResult:
    """Search, time, judge, and search more cautiously for as long as the judge objects and the budget lasts."""
    if request.stop == "first":
        request = replace(request, callback=_ending(request.callback))
    rolling = rolling_endpoints(ends)
    if isinstance(rolling, PlanResult):
        return rolling
    poses = dict(zip(ends.goal_index, request.poses, strict=False))  # none if the goals are configurations
    ends = rolling
    request = replace(request, poses=tuple(poses[k] for k in ends.goal_index) if poses else ())
    found, refused, stats = Search(), None, {}
    elapsed, limit = budget.elapsed, budget.time_limit
    clock = Clock(budget.started + limit, paces_of(request.objective.scene), max(limit - elapsed, 0.0))
    budget.time_limit = until_last_steps(clock, elapsed)
    for problem in problems(request, ends):
        drives = Drives(request=request, ends=ends, problem=problem, clock=clock, cancelled=budget.cancelled)
        # Who listens is told of paths soon.
        chance, heard = copy.deepcopy(rng), request.callback is not None
        plain = Search() if heard else _plain(drives, budget, chance)
        insured = first_verified(drives.stops(plain), request, clock) if drives.walkers is not None else None
        if _passed(insured):  # what comes later may come too late
            drives = replace(drives, insured=True)
            budget.time_limit = until_last_steps(clock, budget.elapsed, insured=True)
        # Among those who move a first motion may take longer than a search.
        early = not heard and (drives.walkers is None or _passed(insured))
        ordinary = drives.ordinary(plain, budget) if early else Ordinary()
        found = _searched(request, problem, budget, rng)
        found = found if found.paths or found.stopped else plain
        stats = {"search_time": budget.elapsed, "iterations": float(budget.spent)}
        first = insured if _passed(insured) else _first(drives, drives.soon(ordinary), found)
        if found.paths and not _passed(insured):  # now it is known what timing and judging take here
            budget.time_limit = min(budget.time_limit, until_last_steps(clock, budget.elapsed))
        judged, soon = first, budget.cancelled() or wants_it_soon(found)
        if not (_passed(first) and soon) and clock.may_do("timing", "judging"):
            if not (early or found.stopped):
                ordinary = drives.ordinary(plain if plain.paths else _plain(drives, budget, chance), budget)
            with budget.share(_for_motions(found, budget)) as part:
                candidates = drives.motions(found, ordinary, part, rng)
            judged = _better(first_verified(candidates, request, clock), first)
        if judged is not None and judged.verdict.passed:
            judged = _in_full(judged, ordinary.reference, drives)
            return solved(judged, found, ends, request, budget, stats)
        refused = refused or judged
        if budget.exhausted or found.stopped or not (found.paths or found.refused):
            break
    return failed(found, ends, refused, budget, stats)


def _ending(callback: Callback | None) -> Callback:
    """Return a callback that ends the search with its first path."""

    def told(point: TracePoint) -> bool:
        if callback is not None:
            callback(point)
        return True

    return told


def _for_motions(found: Search, budget: Budget) -> float:
    """Return how long motions may take [s]; who stopped the search waits no longer for them than for its path."""
    seconds = _MOTIONS_SHARE * budget.remaining_seconds
    return min(seconds, budget.elapsed) if found.stopped else seconds


def _plain(drives: Drives, budget: Budget, rng: np.random.Generator) -> Search:
    """Return what a call with a weight of 0 and the same chance would find."""
    if drives.request.objective.w == 0.0 or budget.exhausted:
        return Search()
    plain = drives.without_regard_for_impact().request
    with budget.share(iterations=_ORDINARY_SHARE * budget.remaining_iterations) as part:
        return _searched(plain, drives.problem, part, rng, share=_ORDINARY_SHARE)


def _first(drives: Drives, soon: list[Motion], found: Search) -> Judged | None:
    """Return a motion that is had should all others come too late."""
    first = first_verified(soon, drives.request, drives.clock)
    return first if _passed(first) else first_verified(drives.stops(found), drives.request, drives.clock) or first


def _searched(
    request: Request, problem: SceneProblem, budget: Budget, rng: np.random.Generator, share: float | None = None
) -> Search:
    moving = bool(request.objective.scene.moving)
    if share is None:
        share = _SHARE if problem.start.size == BASE and not moving else _ARM_SHARE
    if moving:
        return search_among_walkers(request, problem, budget, rng, share=share)
    return search(request.planner, problem, request.objective, budget, rng, request.callback, kept=ALL, share=share)


def _in_full(judged: Judged, reference: Motion | None, drives: Drives) -> Judged:
    """Return a motion charged in full, or the one for a weight of 0 if that turns out to be better."""
    chosen = replace(judged, motion=drives.in_full(judged.motion))
    if drives.walkers is None or reference is None or drives.request.preference is not None:
        return chosen
    if reference.cost.total > _CLOSE * judged.motion.cost.total or chosen.motion.trajectory is reference.trajectory:
        return chosen
    reference = drives.in_full(reference)
    if reference.cost.total >= chosen.motion.cost.total:
        return chosen
    other = first_verified([reference], drives.request, drives.clock)
    return other if other is not None and _passed(other) and not other.verdict.warnings else chosen


def _passed(judged: Judged | None) -> bool:
    return judged is not None and judged.verdict.passed


def _better(one: Judged | None, other: Judged | None) -> Judged | None:
    """Return what passed, better without a warning, better by its ranking."""
    if one is None or other is None or not (_passed(one) and _passed(other)):
        return one if _passed(one) or not _passed(other) else other
    return min(one, other, key=lambda of: (bool(of.verdict.warnings), of.motion.ranking))

"""Searches from scratch, one after the other, so that several classes of paths live until they are compared as motions.

A search goes down into one valley of J along its paths and stays there. Which valley has the best motion shows only
when its paths have become smooth and timed, so the time goes to several searches, each with its own random numbers.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from graceful_plan.planners.anytime.auto import Auto
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.request import Request
from graceful_plan.query.search import ALL, Callback, Search, search
from graceful_plan.result import TracePoint

_SHARE, _NARROW_SHARE = 0.15, 0.4
"""Of the time, for searching, elsewhere and where constraints are narrow; the rest is for descents of what was found as
motions."""
_SECONDS, _ITERATIONS = 0.03, 60
"""How long the searches last: n of them n times as long, each."""
_MOST = 12
"""Searches."""


def search_for_motions(request: Request, problem: SceneProblem, budget: Budget, rng: np.random.Generator) -> Search:
    """Search for paths that motions descend from, several times in a share of the budget if they can.

    Of its paths the best is at the end; `others` are the best of each other search, the best first.
    """
    objective, planner, callback = request.objective, request.planner, request.callback
    held = request.constraints
    asked = _NARROW_SHARE if held.narrow and not held.calm and objective.w > 0.0 else _SHARE
    if objective.descended() is None:
        return search(planner, problem, objective, budget, rng, callback, kept=ALL)
    if not isinstance(planner, Auto) or planner.initial is not None or objective.w == 0.0:
        return search(planner, problem, objective, budget, rng, callback, kept=ALL, share=asked)
    told = _Told(callback)
    n = _number(asked * budget.remaining_seconds, budget.remaining_iterations)
    until = budget.elapsed + asked * budget.remaining_seconds
    runs: list[Search] = []
    for left in range(n, 0, -1):
        ends = budget.elapsed + (until - budget.elapsed) / left
        seconds = ends - budget.elapsed if runs else np.inf
        with budget.share(seconds, budget.remaining_iterations / left) as part:
            share = min(1.0, (ends - budget.elapsed) / max(part.remaining_seconds, 1e-9))
            run = search(planner, problem, objective, part, rng.spawn(1)[0], told, kept=ALL, share=share)
        runs.append(run)
        if run.stopped or budget.exhausted or budget.elapsed >= until:
            break
    return _merged(runs, told)


class _Told:
    """Passes on what improves on all searches before."""

    def __init__(self, callback: Callback | None) -> None:
        self.trace: list[TracePoint] = []
        self._callback = callback

    def __call__(self, point: TracePoint) -> bool | None:
        if self.trace and point.total >= self.trace[-1].total:
            return None
        self.trace.append(point)
        return None if self._callback is None else self._callback(point)


def _number(seconds: float, iterations: float) -> int:
    """How many searches fit in."""
    n = min(math.sqrt(seconds / _SECONDS), math.sqrt(iterations / _ITERATIONS), _MOST)
    return max(1, int(n))


def _merged(runs: list[Search], told: _Told) -> Search:
    with_paths = sorted((run for run in runs if run.paths), key=lambda run: run.trace[-1].total)
    best = with_paths[0] if with_paths else Search()
    return replace(
        best,
        trace=told.trace,
        others=[run.paths[-1] for run in with_paths[1:]],
        firsts=[run.paths[0] for run in with_paths],
        refused=sum(run.refused for run in runs),
        stopped=any(run.stopped for run in runs),
    )

"""Candidate motions of increasing quality: a quick first one, then rounds of search and descents of doubling length.

A round does not depend on the remaining time, so a longer call begins with the same rounds as a shorter one.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graceful_plan.core.kernels import CHECK_STEP, FINE_STEP
from graceful_plan.exceptions import RetimingError
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.answer import BestVerified
from graceful_plan.query.base_planning import base_planning
from graceful_plan.query.candidates.maker import MotionMaker
from graceful_plan.query.candidates.motion_source import MotionSource
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request

CAUTION = ((0.002, CHECK_STEP), (0.005, FINE_STEP), (0.01, FINE_STEP))
"""Clearance [m] and step of edge checks [rad] of the first search, then of the searches after the judge refused."""
_FIRST_ROUND_SECONDS, _FIRST_ROUND_ITERATIONS = 0.05, 60
"""Length of the first round [s] and iterations; each further round is twice as long as the previous one."""
_FIRST_SHORT_ROUND_SECONDS = 0.01
"""Length of the first round if the shortest motion is the best one [s]: about the time of a descent from one path."""


def motions_to_verify(
    request: Request, ends: Endpoints, budget: Budget, rng: np.random.Generator, best: BestVerified
) -> Iterator[Motion]:
    """Yield motions to verify until the budget ends or `best` needs no more.

    While the judge refuses all motions near the first path, the search begins again with more clearance.

    Args:
        request: The request.
        ends: Both ends.
        budget: Budget of the call.
        rng: Random numbers.
        best: The best of the yielded motions that have passed the judge.
    """
    for caution in CAUTION:
        source = _maker(request, ends, problem_of(request, ends, *caution), rng, best)
        best.searched = found = source.search_first(budget)
        if found.paths:
            best.tell(found.trace[-1])
            try:
                for motion in source.first(budget):
                    yield motion
                    if best.motion is not None or budget.remaining_seconds == 0.0:
                        break
            except RetimingError as error:
                best.why_not = str(error)
        ended = best.ended or budget.exhausted or not (found.paths or found.refused)
        if not ended and (best.motion is not None or caution is CAUTION[-1]):
            yield from _better(source, budget, best, request)
            ended = True
        if ended:
            if request.candidates > 1:
                best.add_others(source)
            return


def _maker(
    request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator, best: BestVerified
) -> MotionMaker:
    driving = base_planning(request.objective.scene)
    if driving is not None:
        return driving.motions(request, ends, problem, rng)
    return MotionSource(request, ends, problem, rng, best.tell)


def _better(source: MotionMaker, budget: Budget, best: BestVerified, request: Request) -> Iterator[Motion]:
    """Yield motions, round by round, until the budget ends or `best` needs no more."""
    first = _FIRST_SHORT_ROUND_SECONDS if request.only_length else _FIRST_ROUND_SECONDS
    with budget.share(until=lambda: best.ended or best.converged(source.effort)) as part:
        for one in rounds(part, first, restarts=source.restarts):
            yield from source.round(one, best.ranking)
            best.end_round(source.path_cost)


def rounds(budget: Budget, seconds: float = _FIRST_ROUND_SECONDS, *, restarts: bool = True) -> Iterator[Budget]:
    """Divide a budget into rounds, each twice as long as the previous one; the last one takes the rest.

    Args:
        budget: Budget for all rounds.
        seconds: Length of the first round [s].
        restarts: Whether each round begins a new search; if False, there is one round.
    """
    iterations = _FIRST_ROUND_ITERATIONS
    while not budget.exhausted:
        timed = restarts and budget.timed and budget.remaining_seconds > 2.0 * seconds
        counted = restarts and not budget.timed and budget.remaining_iterations > 2 * iterations
        with budget.share(seconds if timed else np.inf, iterations if counted else np.inf) as part:
            yield part
        if not restarts or (not budget.timed and part.spent == 0):
            return  # without a time limit, the call ends when a search ends early
        seconds, iterations = 2.0 * seconds, 2 * iterations


def problem_of(request: Request, ends: Endpoints, margin: float, check_step: float) -> SceneProblem:
    """Return the problem to search; the margin is lowered to half the clearance of the ends if that is less.

    Args:
        request: The request.
        ends: Both ends.
        margin: Clearance to keep [m].
        check_step: Step of edge checks [rad].
    """
    return SceneProblem(
        kernels=request.constraints.kernels,
        start=ends.departure.q[-1],
        goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
        margin=min(margin, 0.5 * ends.clearance),
        check_step=check_step,
        constraints=request.constraints,
    )

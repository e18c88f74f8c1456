"""The best verified motion of a call, and the result that comes of it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.planners.planner import Budget
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.candidates.search import Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.query.verification import Judged, judged
from graceful_plan.result import PlanResult, PlanStatus, TracePoint

LAST_STEPS = 0.004
"""Time that is kept to time and verify one more motion [s], until a call knows how long that takes in its scene."""
_LAST_STEPS_SHARE = 0.2
"""Share of a time limit that is kept for it at most."""
_GAIN = 1e-3
"""Relative improvement of the best motion that is noticeable."""
_PATIENCE = 32
"""Descents without such an improvement after which a call has converged; benchmark `real_tasks` has what that costs."""


@final
class BestVerified:
    """Verifies motions and keeps the best.

    Args:
        request: What the motions are for.
        ends: Both ends.
        budget: Of the call; it ends early enough to time and verify one more motion.
    """

    def __init__(self, request: Request, ends: Endpoints, budget: Budget) -> None:
        self._request, self._ends, self._budget, self._limit = request, ends, budget, budget.time_limit
        self._keep(LAST_STEPS)
        self.searched = Search()
        """The search that was begun last."""
        self.path_cost = np.inf
        """Least cost of a path of a search, as the search estimates it."""
        self.why_not = ""
        """Why a path has no timing, if that is so."""
        self._best: Judged | None = None
        self._refused: Judged | None = None
        self._told: list[TracePoint] = []
        self._stopped = False
        self._rounds = 0
        self._improved = np.inf, 0
        """Ranking and number of descents when the best motion last became noticeably better."""
        self._stats: dict[str, float] = {}

    @property
    def motion(self) -> Motion | None:
        """The best motion that has passed the judge."""
        return None if self._best is None else self._best.motion

    @property
    def ranking(self) -> float:
        """Its ranking; infinite without one, or with one that the judge warns of."""
        return np.inf if self._best is None or self._best.verdict.warnings else self._best.motion.ranking

    @property
    def ended(self) -> bool:
        """Whether the call needs no more motions."""
        if self._best is None:
            return self._budget.cancelled()
        enough = self._stopped or self._request.stop == "first" or self._budget.cancelled()
        return enough or self._is_optimal(self._best.motion)

    def converged(self, effort: int) -> bool:
        """Tell whether a call that stops once it has converged does so.

        Args:
            effort: Number of descents so far.
        """
        if self._request.stop != "converged" or self._best is None:
            return False
        if self.ranking < (1.0 - _GAIN) * self._improved[0]:
            self._improved = self.ranking, effort
        return effort - self._improved[1] >= _PATIENCE

    def end_round(self, path_cost: float) -> None:
        """Note that a round has ended, and the least cost of a path of its search."""
        self._rounds, self.path_cost = self._rounds + 1, min(self.path_cost, path_cost)

    def tell(self, point: TracePoint) -> bool:
        """Tell the callback of an improvement, unless it has ended the call; return whether it has."""
        if not self._told:
            self._stats |= {"search_time": point.time, "first_path_cost": point.total}
            self.path_cost = point.total
        self._told.append(point)
        if self._request.callback is not None and not self._stopped:
            self._stopped = bool(self._request.callback(point))
        return self._stopped

    def consider(self, motion: Motion) -> None:
        """Verify a motion if it is better than the best and there is time for it; keep it if it passes."""
        began = time.perf_counter()
        first = self._best is None
        late = not first and self._budget.elapsed + self._stats["verification_time"] > self._limit
        if motion.ranking >= self.ranking or late:
            return
        found = judged(motion, self._request)
        took = time.perf_counter() - began
        if not found.verdict.passed:
            self._refused = self._refused or found
            return
        if self._best is not None and found.verdict.warnings:  # no better than one without a warning
            best = self._best
            if not best.verdict.warnings or motion.ranking >= best.motion.ranking:
                return
        self._best = found
        if first:
            self._stats |= {"first_motion_time": self._budget.elapsed, "first_motion_cost": motion.cost.total}
            self._stats |= {"verification_time": took}
            self._keep(max(LAST_STEPS, self._budget.elapsed - self._stats["search_time"]))
        cost = motion.cost
        point = TracePoint(time=self._budget.elapsed, total=cost.total, motion=cost.motion, impact=cost.impact)
        self.tell(point)

    def result(self) -> PlanResult:
        """Return the best motion as a result, or one that says why there is none."""
        budget, motion = self._budget, self.motion
        stats = {**self._stats, "path_cost": self.path_cost, "iterations": float(budget.spent)}
        stats["rounds"] = float(self._rounds)
        if self._best is None or motion is None:
            return replace(self._failed(), stats=stats)
        if motion.estimate is not None:
            stats["estimated_total"] = motion.estimate
        checks = self._best.verdict.checks
        return PlanResult(
            status=PlanStatus.SOLVED,
            detail="; ".join(f"{name}: {checks[name].detail}" for name in self._best.verdict.warnings),
            path=motion.path,
            trajectory=motion.trajectory,
            cost=motion.cost,
            verdict=self._best.verdict,
            trace=tuple(self._trace(motion.cost.total)),
            stats=stats,
            goal_index=self._ends.goal_index[motion.arrival],
        )

    def _failed(self) -> PlanResult:
        found, budget, refused = self.searched, self._budget, self._refused
        ended = PlanStatus.CANCELLED if budget.cancelled() else PlanStatus.TIMEOUT
        trace = tuple(self._told)
        if refused is not None:
            objections = "; ".join(
                f"{name}: {refused.verdict.checks[name].detail}" for name in refused.verdict.failures
            )
            detail = f"the judge refused every motion; the first for {objections}"
            return PlanResult(status=ended, detail=detail, verdict=refused.verdict, trace=trace)
        if self.why_not:
            return PlanResult(status=PlanStatus.RETIMING_FAILED, detail=self.why_not, trace=trace)
        status = ended if budget.exhausted or found.paths else PlanStatus.INFEASIBLE
        return PlanResult(status=status, detail=f"no path after {budget.elapsed:.3f} s")

    def _trace(self, total: float) -> Iterator[TracePoint]:
        """Yield improvements up to that with the cost of the result.

        A search estimates the costs of paths. Those that promised more than any motion has kept are no improvements.
        """
        least = np.inf
        for point in self._told:
            if total <= point.total < least:
                least = point.total
                yield point

    def _keep(self, seconds: float) -> None:
        """Let the budget end so many seconds before the time limit."""
        if np.isfinite(self._limit):
            self._budget.time_limit = self._limit - min(seconds, _LAST_STEPS_SHARE * self._limit)

    def _is_optimal(self, motion: Motion) -> bool:
        """Whether there is no way to go, or only length counts and no motion can be noticeably shorter."""
        request = self._request
        if motion.trajectory.duration == 0.0:
            return True
        if not request.only_length:
            return False
        start = self._ends.departure.q[0]
        nearest = min(float(np.linalg.norm(arrival.q[-1] - start)) for arrival in self._ends.arrivals)
        return motion.cost.motion <= (1.0 + _GAIN) * nearest

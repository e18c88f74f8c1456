"""The best verified motion of a call, and the result of the call."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.planners.planner import Budget
from graceful_plan.query.candidates.distinct import DistinctPaths
from graceful_plan.query.candidates.maker import MotionMaker
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.candidates.search import Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.query.verification import VerifiedMotion, judged
from graceful_plan.result import PlanResult, PlanStatus, TracePoint

LAST_STEPS = 0.004
"""Reserve of the time budget for timing and verifying one more motion [s], until a call has measured it."""
_LAST_STEPS_SHARE = 0.2
"""Largest reserve, as a share of the time limit, also for several candidates."""
_MUCH_WORSE = 2.0
"""Largest ratio of a candidate's ranking to that of the best motion."""
_GAIN = 1e-3
"""Least relative improvement of the best motion that counts for convergence and optimality."""
_PATIENCE = 32
"""Descents without an improvement after which a call has converged; benchmark `real_tasks` measures the loss."""


@final
class BestVerified:
    """Verifies motions and keeps the best one.

    Args:
        request: The request that the motions serve.
        ends: Both ends.
        budget: Budget of the call; its time limit is shortened by the reserve for one more motion per candidate.
    """

    def __init__(self, request: Request, ends: Endpoints, budget: Budget) -> None:
        self._request, self._ends, self._budget, self._limit = request, ends, budget, budget.time_limit
        self._keep(LAST_STEPS)
        self.searched = Search()
        """Result of the latest search."""
        self.path_cost = np.inf
        """Least estimated cost of a path that the searches have found."""
        self.why_not = ""
        """Reason why the first path cannot be timed; empty if it can."""
        self._best: VerifiedMotion | None = None
        self._passed: list[VerifiedMotion] = []
        self._others: list[VerifiedMotion] = []
        self._refused: VerifiedMotion | None = None
        self._told: list[TracePoint] = []
        self._stopped = False
        self._rounds = 0
        self._improved = np.inf, 0
        """Ranking and number of descents at the last improvement that counts."""
        self._stats: dict[str, float] = {}

    @property
    def motion(self) -> Motion | None:
        """The best motion that has passed the judge."""
        return None if self._best is None else self._best.motion

    @property
    def ranking(self) -> float:
        """Ranking of the best motion; infinite if there is none, or if its verdict has warnings."""
        return np.inf if self._best is None or self._best.verdict.warnings else self._best.motion.ranking

    @property
    def ended(self) -> bool:
        """Whether the call needs no more motions."""
        if self._best is None:
            return self._budget.cancelled()
        enough = self._stopped or self._request.stop == "first" or self._budget.cancelled()
        return enough or self._is_optimal(self._best.motion)

    def converged(self, effort: int) -> bool:
        """Return whether the call has converged and stops for that reason.

        Args:
            effort: Number of descents that have ended.
        """
        if self._request.stop != "converged" or self._best is None:
            return False
        if self.ranking < (1.0 - _GAIN) * self._improved[0]:
            self._improved = self.ranking, effort
        return effort - self._improved[1] >= _PATIENCE

    def end_round(self, path_cost: float) -> None:
        """Count a round, and note the least estimated cost of a path that its search has found."""
        self._rounds, self.path_cost = self._rounds + 1, min(self.path_cost, path_cost)

    def tell(self, point: TracePoint) -> bool:
        """Record an improvement and call the callback; return whether the callback has ended the call."""
        if not self._told:
            self._stats |= {"search_time": point.time, "first_path_cost": point.total}
            self.path_cost = point.total
        self._told.append(point)
        if self._request.callback is not None and not self._stopped:
            self._stopped = bool(self._request.callback(point))
        return self._stopped

    def consider(self, motion: Motion) -> None:
        """Verify a motion if it is better than the best one and time allows; keep it if it passes."""
        began = time.perf_counter()
        first = self._best is None
        if motion.ranking >= self.ranking or self._late:
            return
        found = judged(motion, self._request)
        took = time.perf_counter() - began
        if not found.verdict.passed:
            self._refused = self._refused or found
            return
        self._passed.append(found)
        if self._best is not None and found.verdict.warnings:  # motions without warnings come first
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

    def add_others(self, source: MotionMaker) -> None:
        """Verify motions that are distinct from the best one and from each other, as far as asked for and time allows.

        Args:
            source: The source of the call's motions; it makes motions of the other local minima that it has found.
        """
        if self._best is None:
            return
        best, chosen, paths = self._best, list[VerifiedMotion](), DistinctPaths()
        paths.add(best.motion.path.q)

        def is_new(q: Float[Array, "n nq"]) -> bool:
            return not self._late and paths.has_none_like(q)

        def keep(found: VerifiedMotion) -> None:
            chosen.append(found)
            paths.add(found.motion.path.q)

        for motion in source.others(is_new):
            worse = motion.ranking > _MUCH_WORSE * best.motion.ranking
            if worse or len(chosen) + 1 >= self._request.candidates or self._late or self._budget.cancelled():
                break
            if is_new(motion.path.q) and (found := judged(motion, self._request)).verdict.passed:
                keep(found)
        for found in sorted(self._passed, key=_ranking):
            alike = found.motion.ranking <= _MUCH_WORSE * best.motion.ranking
            if alike and paths.has_none_like(found.motion.path.q):
                keep(found)
        self._others = sorted(chosen, key=_ranking)[: self._request.candidates - 1]

    @property
    def _late(self) -> bool:
        """Whether no time is left to verify one more motion."""
        return self._best is not None and self._budget.elapsed + self._stats["verification_time"] > self._limit

    def result(self) -> PlanResult:
        """Return the result of the call: the best motion, or the reason why there is none."""
        budget, motion = self._budget, self.motion
        stats = {**self._stats, "path_cost": self.path_cost, "iterations": float(budget.spent)}
        stats["rounds"] = float(self._rounds)
        if self._best is None or motion is None:
            return replace(self._failed(), stats=stats)
        if motion.estimate is not None:
            stats["estimated_total"] = motion.estimate
        result = self._solved(self._best)
        several = self._request.candidates > 1
        return replace(
            result,
            trace=tuple(self._trace(motion.cost.total)),
            stats=stats,
            candidates=(result, *map(self._solved, self._others)) if several else (),
        )

    def _solved(self, found: VerifiedMotion) -> PlanResult:
        motion, verdict = found.motion, found.verdict
        return PlanResult(
            status=PlanStatus.SOLVED,
            detail="; ".join(f"{name}: {verdict.checks[name].detail}" for name in verdict.warnings),
            path=motion.path,
            trajectory=motion.trajectory,
            cost=motion.cost,
            verdict=verdict,
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
            detail = f"the judge refused every motion; violations of the first: {objections}"
            return PlanResult(status=ended, detail=detail, verdict=refused.verdict, trace=trace)
        if self.why_not:
            return PlanResult(status=PlanStatus.RETIMING_FAILED, detail=self.why_not, trace=trace)
        if found.paths:
            return PlanResult(status=ended, detail="the time was up before a motion along the path", trace=trace)
        gave_up = not (budget.exhausted or found.paths)
        told = f"; {self._request.planner.name} gave up, another planner may find one" if gave_up else ""
        return PlanResult(status=ended, detail=f"no path after {budget.elapsed:.3f} s{told}")

    def _trace(self, total: float) -> Iterator[TracePoint]:
        """Yield the improvements until the cost of the result is reached.

        Costs of paths are estimates. Paths with an estimate below the cost of the result are left out.
        """
        least = np.inf
        for point in self._told:
            if total <= point.total < least:
                least = point.total
                yield point

    def _keep(self, seconds: float) -> None:
        """Reserve time at the end of the call for one more motion."""
        if np.isfinite(self._limit):
            seconds *= self._request.candidates
            self._budget.time_limit = self._limit - min(seconds, _LAST_STEPS_SHARE * self._limit)

    def _is_optimal(self, motion: Motion) -> bool:
        """Whether the start is the goal, or only length counts and no motion can be shorter by more than `_GAIN`."""
        request = self._request
        if motion.trajectory.duration == 0.0:
            return True
        if not request.only_length:
            return False
        start = self._ends.departure.q[0]
        nearest = min(float(np.linalg.norm(arrival.q[-1] - start)) for arrival in self._ends.arrivals)
        return motion.cost.motion <= (1.0 + _GAIN) * nearest


def _ranking(found: VerifiedMotion) -> float:
    return found.motion.ranking

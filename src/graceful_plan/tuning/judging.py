"""From candidates to points of a front: each timed, judged and charged anew."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import final

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.query.ends import Ends
from graceful_plan.query.finish import first_verified
from graceful_plan.query.motions import along
from graceful_plan.query.request import Request
from graceful_plan.tuning.archive import Archive, Candidate
from graceful_plan.tuning.points import ParetoPoint

_JUDGING = 0.05
"""Seconds that timing and judging a point may take, at first guess."""
_LONGER = 2.5
"""How much longer it takes than for the shortest path."""
_JUDGING_SHARE = 0.35
"""Share of the time limit that is kept for it at most."""
_LATE = 3
"""Candidates that are judged after the time limit if none has passed."""


@final
@dataclass(frozen=True, kw_only=True)
class FrontQuery:
    """What a front is asked for.

    Args:
        ends: From where to where.
        request: As of `plan`; its objective's own weight does not matter.
    """

    ends: Ends
    request: Request

    def at(self, w: float) -> SceneObjective:
        """The objective with another weight."""
        objective = self.request.objective
        return objective.objective.with_weight(w).bind(objective.scene, objective.paces)

    def point(self, candidate: Candidate) -> ParetoPoint | None:
        """Time, judge and charge a candidate; None if the judge refuses it."""
        judged = first_verified(along(Path(candidate.q), self.request, self.ends), self.request)
        if judged is None or not judged.verdict.passed:
            return None
        return ParetoPoint(
            path=judged.motion.path,
            trajectory=judged.motion.trajectory,
            cost=judged.motion.cost,
            verdict=judged.verdict,
            made_by=candidate.made_by,
            made_with=candidate.made_with,
        )


@final
class Judging:
    """What of an archive has been judged.

    Args:
        query: What was asked for.
        archive: Candidates; those that are refused are dropped from it.
        points: Most points of the front.
    """

    def __init__(self, query: FrontQuery, archive: Archive, points: int) -> None:
        self._query, self._archive, self._points = query, archive, points
        self._passed: dict[int, ParetoPoint] = {}
        """Points by the identity of their candidates, which `_kept` keeps alive."""
        self._kept: list[Candidate] = []
        self._each = _JUDGING
        self.refused = 0

    @property
    def begun(self) -> bool:
        """Whether any candidate has passed."""
        return bool(self._passed)

    def reserve(self, limit: float) -> float:
        """Return how much of a time limit to keep for judging all points [s]."""
        return min(self._each * self._points, _JUDGING_SHARE * limit)

    def time_shortest(self) -> None:
        """Judge the shortest path to see how long that takes here and now."""
        began, shortest = time.perf_counter(), self._archive.candidates[0]
        point = self._query.point(shortest)
        if point is not None:
            self._pass(shortest, point)
        # Paths around something have more corners to time and more places to look at than the shortest.
        self._each = max(_JUDGING, _LONGER * (time.perf_counter() - began))

    def front(self, budget: Budget) -> list[ParetoPoint]:
        """Judge the candidates that stand for all best; others take the place of those that are refused."""
        while True:
            chosen = self._archive.chosen(self._points)
            # From coarse to fine: whenever time is over, what was judged covers the front.
            waiting = [chosen[i] for i in _coarse_to_fine(len(chosen)) if id(chosen[i]) not in self._passed]
            if not waiting:
                return [self._passed[id(candidate)] for candidate in chosen]
            for candidate in waiting:
                if budget.elapsed >= budget.time_limit and (self._passed or self.refused >= _LATE):
                    return list(self._passed.values())
                point = self._query.point(candidate)
                if point is None:
                    self._archive.drop(candidate)
                    self.refused += 1
                    break
                self._pass(candidate, point)

    def _pass(self, candidate: Candidate, point: ParetoPoint) -> None:
        self._passed[id(candidate)] = point
        self._kept.append(candidate)


def _coarse_to_fine(n: int) -> list[int]:
    """Order 0 to n - 1: both ends, then the middle, then the middles of the halves, and so on."""
    order, step = [0, n - 1] if n > 1 else list(range(n)), 1
    while len(order) < n:
        step *= 2
        order += [i for i in (round((n - 1) * k / step) for k in range(1, step, 2)) if i not in order]
    return order

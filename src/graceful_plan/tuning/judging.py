"""Judging of candidates: from timed motions to verified points of a front."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Generic, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.query.candidates.motions import Motion, along
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.query.verification import first_verified
from graceful_plan.tuning.archive import Archive, C, Candidate, coarse_to_fine
from graceful_plan.tuning.points import ParetoPoint

_JUDGING = 0.03
"""Initial guess of the time to time and judge a point [s]."""
LONGER = 2.5
"""Judging time of a path relative to that of the shortest path; detours have more corners to time."""
MOTION_LONGER = 1.5
"""Judging time of a smooth motion relative to that of the shortest motion; measured: 1.1 to 1.4."""
_JUDGING_SHARE = 0.35
"""Largest fraction of the time limit reserved for judging."""
_LATE = 3
"""Number of rejected candidates after which judging stops past the time limit, if none has passed."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FrontMotion:
    """A timed motion that has not been judged.

    Args:
        motion: The motion.
        made_by: "descent", or the method that found the path if this is a path with rounded corners.
        made_with: Weight of the descent, or `made_with` of the path.
    """

    motion: Motion
    made_by: str
    made_with: float
    cost: Float[Array, " 2"] = field(init=False)
    """Motion and impact of its trajectory."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cost", np.array([self.motion.cost.motion, self.motion.cost.impact]))

    @property
    def whole(self) -> tuple[Path, int]:
        """Path from which other motions may start their descent, and the index of its arrival."""
        return self.motion.path, self.motion.arrival


@final
@dataclass(frozen=True, kw_only=True)
class FrontQuery:
    """The query of a front.

    Args:
        ends: Start and goals.
        request: As for `plan`; the objective's own weight is ignored.
    """

    ends: Endpoints
    request: Request

    def at(self, w: float) -> SceneObjective:
        """Return the objective with another weight."""
        objective = self.request.objective
        return objective.objective.with_weight(w).bind(objective.scene, objective.paces)

    @property
    def descends(self) -> bool:
        """Whether smooth motions can descend along the objective."""
        return self.at(1.0).descended() is not None

    def point_along(self, candidate: Candidate) -> ParetoPoint | None:
        """Time a path with rounded corners, judge and evaluate it; None if the judge rejects it."""
        motions = along(Path(candidate.q), self.request, self.ends)
        return self._point(motions, candidate.made_by, candidate.made_with)

    def point_of(self, one: FrontMotion) -> ParetoPoint | None:
        """Judge a motion; None if the judge rejects it."""
        return self._point([one.motion], one.made_by, one.made_with)

    def _point(self, motions: Iterable[Motion], made_by: str, made_with: float) -> ParetoPoint | None:
        try:
            judged = first_verified(motions, self.request)
        except RetimingError:  # the path cannot be timed
            return None
        if judged is None or not judged.verdict.passed:
            return None
        return ParetoPoint(
            path=judged.motion.path,
            trajectory=judged.motion.trajectory,
            cost=replace(judged.motion.cost, w=self.request.objective.w),
            verdict=judged.verdict,
            made_by=made_by,
            made_with=made_with,
        )


@final
class Judging(Generic[C]):
    """Judges the candidates of an archive and keeps the results.

    Args:
        archive: Candidates; rejected ones are dropped from it.
        point: Judges a candidate; returns None if it is rejected.
        points: Largest number of points of the front.
        longer: Judging time of a candidate relative to that of the shortest one.
    """

    def __init__(
        self, archive: Archive[C], point: Callable[[C], ParetoPoint | None], points: int, longer: float
    ) -> None:
        self._archive, self._point, self._points, self._longer = archive, point, points, longer
        self._passed: dict[int, ParetoPoint] = {}
        """Points by the id of their candidates, which `_kept` keeps alive."""
        self._kept: list[C] = []
        self._each, self._timed = _JUDGING, False
        self.refused = 0

    def reserve(self, limit: float) -> float:
        """Return the part of a time limit to reserve for judging all points [s]."""
        return min(self._each * self._points, _JUDGING_SHARE * limit)

    def time_first(self) -> bool:
        """Judge the shortest candidate once, to measure the judging time; return whether it was done in this call."""
        if self._timed or not len(self._archive):
            return False
        self._timed = True
        began, shortest = time.perf_counter(), self._archive.candidates[0]
        point = self._point(shortest)
        if point is not None:
            self._pass(shortest, point)
        self._each = self._longer * (time.perf_counter() - began)
        return True

    def front(self, budget: Budget) -> list[ParetoPoint]:
        """Judge a representative subset of the archive; rejected candidates are replaced by others."""
        while True:
            chosen = self._archive.chosen(self._points)
            # From coarse to fine, so that the judged points cover the front whenever time runs out.
            waiting = [chosen[i] for i in coarse_to_fine(len(chosen)) if id(chosen[i]) not in self._passed]
            if not waiting:
                return [self._passed[id(candidate)] for candidate in chosen]
            for candidate in waiting:
                if budget.elapsed >= budget.time_limit and (self._passed or self.refused >= _LATE):
                    return list(self._passed.values())
                point = self._point(candidate)
                if point is None:
                    self._archive.drop(candidate)
                    self.refused += 1
                    break
                self._pass(candidate, point)

    def _pass(self, candidate: C, point: ParetoPoint) -> None:
        self._passed[id(candidate)] = point
        self._kept.append(candidate)

r"""From a front of paths to a front of smooth motions, each optimised along J with its own timing.

The paths of a search have corners and are evaluated at a mean pace, so paths near the front are no longer near it once
they are timed. Therefore a representative subset of them descends as smooth motions. Each descends at a weight for
which it is optimal, starting also from its neighbours and from motions found at other weights. Then the widest gap
between two motions is filled repeatedly: both motions, and random moves of them, descend at the weight at which they
have the same cost,

.. math:: w = (V_b - V_a) / (S_a - S_b),

which leads to a point in between wherever the front is convex. In alternation, a representative subset of the front
descends on a fine grid, each motion at a weight between those of its neighbours.

References:
    Y. P. Aneja and K. P. K. Nair, "Bicriteria transportation problem", Management Science 1979 (weights of gaps).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import count, islice, pairwise
from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.objective import MAX_WEIGHT
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.descent_rounds import descend_from
from graceful_plan.planners.motion_descent import DescentSettings
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.descents import motion_descents, start_along
from graceful_plan.query.candidates.motions import Motion, along, timed_curve
from graceful_plan.tuning.archive import Archive, Candidate, coarse_to_fine, scaled
from graceful_plan.tuning.judging import FrontMotion, FrontQuery
from graceful_plan.tuning.search import sweep_weights

# Of the values tried, these had the largest hypervolume and the least V + w S, at four weights on four tasks. Halving
# or doubling any of them makes little difference.
_FROM_PATHS = 0.25
"""Fraction of the time for motions from paths."""
_ASIDE = 4.0
"""Ratio of the neighbouring weights whose best motions also start a descent."""
_HOPS, _END_HOPS = 2, 4
"""Random moves of the motions at a gap, and beyond the end of least impact, times the attempts at that gap.

The point of least impact depends most on chance, so motions there descend on a fine grid at once."""
_DISCOUNT = 0.25
"""Factor on the value of a gap per attempt to fill it."""
_THREADS = 2
_MOST_TIMED = 4
"""Number of curves to time per round of descents."""
_FINELY = DescentSettings(screens=False, fine=1, refinements=0)


class Resources(NamedTuple):
    """Time and random numbers for one part of the work."""

    budget: Budget
    rng: np.random.Generator


@final
class MotionFront:
    """Fills an archive with smooth motions.

    Args:
        query: The query; its objective must have a descent.
        problem: The planning problem of the search.
        archive: Archive to fill.
        points: Largest number of points of the front.
    """

    def __init__(self, query: FrontQuery, problem: SceneProblem, archive: Archive[FrontMotion], points: int) -> None:
        self.query, self.problem, self.archive, self.points = query, problem, archive, points
        self._greatest = 0.0
        """Weight at the end of least impact."""
        self._fine: set[FrontMotion] = set()
        self._tried: dict[tuple[FrontMotion, FrontMotion], int] = {}

    def fill(
        self, paths: Archive[Candidate], budget: Budget, rng: np.random.Generator, *, gaps: bool = True
    ) -> Iterator[str]:
        """Fill the archive until the time is over, or by a fixed number of descents without limit. Yields stages.

        Args:
            paths: Initial paths.
            budget: Time for the descents; they spend no iterations.
            rng: Random numbers of the moves.
            gaps: Whether to fill gaps between motions.
        """
        for _ in self._from_paths(paths, Resources(budget, rng)):
            yield "descend"
        timed = budget.timed
        for step in count():
            if budget.elapsed >= budget.time_limit or not len(self.archive):
                return
            rough = self._rough()
            weighs = gaps and self.archive.candidates[0].cost[1] > 0.0 and (timed or step < self.points)
            if weighs and not (rough and step % 2):
                self._into_widest_gap(Resources(budget, rng))
                yield "gaps"
            elif rough:
                self._descend_finely(rough[:_THREADS], Resources(budget, rng))
                yield "polish"
            else:
                return

    def _from_paths(self, paths: Archive[Candidate], resources: Resources) -> Iterator[None]:
        """Descend from a representative subset of the paths."""
        budget, rng = resources
        if not len(paths):
            return
        chosen = paths.chosen(self.points)
        self._greatest = float(sweep_weights(paths.costs[0], 2)[1])
        weights = optimal_weights(np.array([candidate.cost for candidate in chosen]), self._greatest)
        end = budget.elapsed + _FROM_PATHS * budget.remaining_seconds
        for done, k in enumerate(coarse_to_fine(len(chosen))):
            if len(self.archive) and budget.elapsed >= end:
                return
            with budget.share((end - budget.elapsed) / (len(chosen) - done)) as part:
                self._from_path(chosen, k, weights[k], Resources(part, rng))
            yield

    def _from_path(self, chosen: Sequence[Candidate], k: int, w: float, resources: Resources) -> None:
        beside = [self.query.ends.joined(Path(candidate.q)) for candidate in chosen[max(0, k - 1) : k + 2]]
        found = self._descended(
            [*beside, *self._near(w)], w, DescentSettings(bends=0, fine=0, refinements=0), resources
        )
        if not found:
            cut = self._along(Path(chosen[k].q))
            made_by, made_with = chosen[k].made_by, chosen[k].made_with
            found = [FrontMotion(motion=motion, made_by=made_by, made_with=made_with) for motion in cut]
        for one in found:
            self.archive.offer(one)

    def _along(self, path: Path) -> list[Motion]:
        """Return a motion along a path with rounded corners, in a list; empty if it cannot be timed."""
        try:
            return list(islice(along(path, self.query.request, self.query.ends), 1))
        except RetimingError:
            return []

    def _near(self, w: float) -> list[tuple[Path, int]]:
        """Return starts of a descent: the best motions at this weight, at a lower one and at a higher one."""
        if not len(self.archive):
            return []
        best = dict.fromkeys(self.archive.best_for(w * factor) for factor in (1.0, _ASIDE, 1.0 / _ASIDE))
        return [one.whole for one in best]

    def _into_widest_gap(self, resources: Resources) -> None:
        a, b = rims = self._widest()
        self._tried[rims] = tried = self._tried.get(rims, 0) + 1
        if a is b:
            settings = DescentSettings(bends=0, fine=1, refinements=_END_HOPS * tried)
            found = self._descended(self._near(self._greatest), self._greatest, settings, resources)
        else:
            settings = DescentSettings(bends=0, fine=0, refinements=_HOPS * tried)
            found = self._descended([a.whole, b.whole], _slope(a.cost, b.cost), settings, resources)
        for one in found:
            self.archive.offer(one)

    def _widest(self) -> tuple[FrontMotion, FrontMotion]:
        """Return both sides of the most valuable gap; the space beyond the end of least impact counts as one."""
        front = self.archive.candidates
        gaps = [*pairwise(front), (front[-1], front[-1])]
        areas = np.prod(np.abs(np.diff(scaled(self.archive.costs), axis=0)), axis=1)
        worth = np.append(areas, areas.max(initial=0.0)) * _DISCOUNT ** np.array([self._tried.get(g, 0) for g in gaps])
        return gaps[int(np.argmax(worth))]

    def _rough(self) -> list[tuple[FrontMotion, float]]:
        """Return the representative motions that have not descended on a fine grid, coarse to fine, with weights."""
        chosen = self.archive.chosen(self.points)
        weights = optimal_weights(np.array([one.cost for one in chosen]), self._greatest)
        return [(chosen[k], weights[k]) for k in coarse_to_fine(len(chosen)) if chosen[k] not in self._fine]

    def _descend_finely(self, some: Sequence[tuple[FrontMotion, float]], resources: Resources) -> None:
        with ThreadPoolExecutor(_THREADS) as pool:
            every = pool.map(lambda one: self._descended([one[0].whole], one[1], _FINELY, resources), some)
            found = [new for news in every for new in news]
        self._fine.update(found, (one for one, _ in some))
        for one in found:
            self.archive.offer(one)

    def _descended(
        self,
        starts: Sequence[tuple[Path, int]],
        w: float,
        settings: DescentSettings,
        resources: Resources,
    ) -> list[FrontMotion]:
        request, ends = replace(self.query.request, objective=self.query.at(w)), self.query.ends
        descents, (budget, rng) = motion_descents(request, self.problem, settings), resources
        begun = [start_along(path, arrival, ends) for path, arrival in starts if path.length > 0.0]
        results = sorted(descend_from(begun, descents, budget, rng), key=lambda one: one.value) if descents else []
        motions = (timed_curve(one, request) for one in results[:_MOST_TIMED])
        return [FrontMotion(motion=one, made_by="descent", made_with=w) for one in motions if one is not None]


def optimal_weights(costs: Float[Array, "n 2"], greatest: float) -> list[float]:
    """Return a weight per point of a front, sorted by motion: between those of equal cost with its neighbours.

    Args:
        costs: Motion and impact of one or more points; the weight of the first is 0.
        greatest: Weight of the last point.
    """
    slopes = [_slope(a, b) for a, b in pairwise(costs)]
    inner = [float(np.sqrt(a * b)) for a, b in pairwise(slopes)]
    return [0.0, *inner, greatest][: len(costs)]


def _slope(a: Float[Array, " 2"], b: Float[Array, " 2"]) -> float:
    """Return the weight at which two points have the same cost."""
    return float(np.clip((b[0] - a[0]) / max(a[1] - b[1], 1e-300), 0.0, MAX_WEIGHT))

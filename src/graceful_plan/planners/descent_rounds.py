"""Rounds of descents of whole motions: from many starts, coarse to fine, followed by refinements of the best curves.

A path does not show which local minimum its motion ends in. So many starts descend in stages of increasing resolution,
and only the better ones are kept after each stage:

- a *bend* is a smooth random bump that is added to a path or curve;
- a *start* is a path of a search, a curve of an earlier descent, or a path with wide bends;
- a *refinement* adds a narrow bend to one of the best curves and descends again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path, evenly
from graceful_plan.planners.motion_descent import COARSE, FINE, DescentResult, MotionDescents, SmoothCurve, Stage, Start
from graceful_plan.planners.planner import Budget

_T = TypeVar("_T")

_WORKERS = 2
_KEPT = 4
"""One in `_KEPT` descents proceeds to the next stage, but at least `_LEAST` of them."""
_LEAST = 2
_COARSE_SHARE, _MIDDLE_SHARE = 0.3, 0.6
"""Shares of the time after which the coarse and the middle stage begin no more descents."""
_UNTIMED_BENDS, _UNTIMED_REFINEMENTS = 4, 2
"""Bent starts and refinements in a round without a time limit."""
_MOST_BENDS, _MOST_REFINEMENTS = 5000, 2000
_PROMISING = (1.2, 1.05)
"""Largest ratio of J to that of the best curve at which a refinement proceeds, after its coarse and middle stage."""
_NARROW = (0.1, 1.0)
"""Least and greatest size of the bend of a refinement [rad]."""
_WIDE = (0.3, 1.5)
"""Least and greatest size of the bends of starts [rad]; `_WIDE_BENDS` of them add up."""
_WIDE_BENDS = 2
_RESAMPLED = 64
"""Points of the path that represents a curve as the start of the next descent."""


def descend_from(
    starts: Sequence[Start],
    descents: MotionDescents,
    budget: Budget,
    rng: np.random.Generator,
    best: Sequence[DescentResult] = (),
    screened: list[DescentResult] | None = None,
) -> Iterator[DescentResult]:
    """Yield free curves from descents, then refinements of the best curves.

    Without a time limit the number of descents is fixed, so the result does not depend on the clock.

    Args:
        starts: Paths to descend from.
        descents: Objective and settings of the descents.
        budget: Budget of the round.
        rng: Random numbers for bends.
        best: Results of earlier rounds, which may be refined, too.
        screened: Receives the free curves of the coarse and middle stages, most of which are not descended further.
    """
    with ThreadPoolExecutor(_WORKERS) as pool:
        yield from _Round(descents, starts, budget, rng, pool, list(best), [] if screened is None else screened).run()


@dataclass
class _Round:
    """Descents from coarse to fine, then refinements."""

    descents: MotionDescents
    starts: Sequence[Start]
    budget: Budget
    rng: np.random.Generator
    pool: Executor
    results: list[DescentResult]
    screened: list[DescentResult]

    def run(self) -> Iterator[DescentResult]:
        settings, budget = self.descents.settings, self.budget
        before, earlier = len(self.results), len(self.screened)
        jobs = self._screened(self.screened) if settings.screens else list(self.starts[: settings.fine])
        if settings.hurries:
            for k, found in self._finished(jobs, settings.middle):
                jobs[k] = _from_curve(jobs[k], found.curve)
                yield found
        yield from (found for _, found in self._finished(jobs, FINE))
        if len(self.results) == before:  # coarse values are inaccurate, so coarse curves serve only as a fallback
            self.results += sorted(self.screened[earlier:], key=_value)[:_LEAST]
            yield from self.results[before:]
        most = _MOST_REFINEMENTS if budget.timed else _UNTIMED_REFINEMENTS
        for _ in range(0, most if settings.refinements is None else settings.refinements, _WORKERS):
            if budget.over or not self.results:
                return
            yield from self._refined()

    def _screened(self, free: list[DescentResult]) -> list[Start]:
        """Return the better starts after the coarse and the middle stage; add curves that are free to `free`."""
        if not self.starts:
            return []
        budget, middle = self.budget, self.descents.settings.middle
        began, seconds = budget.elapsed, budget.remaining_seconds
        with budget.share(_COARSE_SHARE * seconds) as part:
            ended = self._coarse(part, free)
        with budget.share(began + _MIDDLE_SHARE * seconds - budget.elapsed) as part:
            ended = self._descended(_better(ended), middle, part, free)
        return _better(ended)

    def _coarse(self, budget: Budget, free: list[DescentResult]) -> list[tuple[float, Start]]:
        """Descend coarsely from all starts, and from starts with wide bends."""
        jobs = self._descended(self.starts, COARSE, budget, free)
        bends = self.descents.settings.bends
        most = bends if bends is not None else _MOST_BENDS if budget.timed else _UNTIMED_BENDS
        for _ in range(0, most, _WORKERS):
            if budget.over:
                break
            chosen = [self.starts[k] for k in self.rng.integers(len(self.starts), size=_WORKERS)]
            jobs += self._descended([self._widely_bent(start) for start in chosen], COARSE, budget, free)
        return jobs

    def _descended(
        self, starts: Sequence[Start], stage: Stage, budget: Budget, free: list[DescentResult]
    ) -> list[tuple[float, Start]]:
        """Return the values of the final curves, with these curves as new starts; add free curves to `free`."""
        ended: list[tuple[float, Start]] = []
        done = self._each(lambda start: self.descents.descended(start, stage, budget), starts)
        for descent, start in zip(done, starts, strict=True):
            if descent is None:
                continue
            curve = start.kind.curve(descent.controls)
            ended.append((descent.value, _from_curve(start, curve)))
            if self.descents.is_free(curve, start):
                free.append(DescentResult(curve, descent.value, start))
        self.descents.effort.descents += len(starts)
        return ended

    def _finished(self, starts: Sequence[Start], stage: Stage) -> Iterator[tuple[int, DescentResult]]:
        """Yield free curves, each with the index of its start."""
        if self.descents.settings.fine:
            done = self._each(lambda start: self.descents.finished(start, stage, self.budget), list(starts))
            # The caller may end the budget at a result. Without a time limit, that must not affect parallel descents.
            for k, one in enumerate(done if self.budget.timed else list(done)):
                self.descents.effort.descents += 1
                if one is not None:
                    self.results.append(one)
                    yield k, one

    def _each(self, do: Callable[[Start], _T], starts: Sequence[Start]) -> Iterator[_T]:
        """Apply a function to all starts in parallel; a single start runs in the calling thread."""
        return map(do, starts) if len(starts) == 1 else self.pool.map(do, starts)

    def _refined(self) -> Iterator[DescentResult]:
        """Bend two of the best curves and descend, stage by stage, while they are close enough to the best J."""
        settings = self.descents.settings
        best = sorted(self.results, key=_value)[:_WORKERS]
        chosen = [best[0] if self.rng.uniform() < 0.5 else best[-1] for _ in range(_WORKERS)]
        jobs = [self._bent(one.curve.even(_RESAMPLED), one.start, _NARROW) for one in chosen]
        free = list[DescentResult]()
        for stage, most in zip((COARSE, settings.middle), _PROMISING, strict=True):
            ended = self._descended(jobs, stage, self.budget, free)
            jobs = [start for value, start in sorted(ended, key=lambda job: job[0]) if value < most * best[0].value]
        if settings.fine:
            yield from (found for _, found in self._finished(jobs[: settings.fine], FINE))
        else:
            self.results += free
            yield from free

    def _widely_bent(self, start: Start) -> Start:
        q = evenly(start.path.q, _RESAMPLED)
        for _ in range(_WIDE_BENDS):
            q = self._bent(q, start, _WIDE).path.q
        return replace(start, path=Path(q), curve=None)

    def _bent(self, q: Float[Array, "n nq"], start: Start, sizes: tuple[float, float]) -> Start:
        """Add a bend of random place, width, size [rad] and direction to a curve."""
        s = np.linspace(0.0, 1.0, len(q))[:, None]
        centre, width = self.rng.uniform(0.1, 0.9), self.rng.uniform(0.15, 0.8)
        direction = self.rng.normal(size=q.shape[1])
        least, most = sizes
        size = least * (most / least) ** self.rng.uniform() / np.linalg.norm(direction)
        bump = np.maximum(0.0, 1.0 - ((s - centre) / width) ** 2) ** 2 * np.minimum(1.0, 8.0 * s * (1.0 - s))
        bent = q + size * bump * direction
        if self.descents.projected is not None:  # random bends would tilt an object that has to stay level
            bent[1:-1] = self.descents.projected(bent[1:-1])
        return replace(start, path=Path(bent), curve=None)


def _from_curve(start: Start, curve: SmoothCurve) -> Start:
    return replace(start, path=Path(curve.even(_RESAMPLED)), curve=curve)


def _value(result: DescentResult) -> float:
    return result.value


def _better(ended: Sequence[tuple[float, Start]]) -> list[Start]:
    """Return the starts that proceed to the next stage, the best first."""
    kept = max(_LEAST, len(ended) // _KEPT)
    return [start for _, start in sorted(ended, key=lambda job: job[0])[:kept]]

"""Smooth motions from paths: control points of a spline descend along J of the motion as it will be executed.

The core does the work (`search/motion_descent.hpp`), with the speed profile as part of the gradient. Paths do not show
which local minimum has the best motion. So descents from many starts go from coarse to fine, and at each stage only
the better ones are kept:

- a *start* is a path of a search, a curve that has descended before, or such a path with a wide random bend;
- a *refinement* bends one of the best curves at random and lets it descend again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TypeVar, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.resampling import evenly
from graceful_plan.timing.spline import Spline, grid_points

Array = np.ndarray
_T = TypeVar("_T")

TIME_PRICE = 0.05
"""Cost of a second of motion on top of J [rad/s]; it decides between motions of about the same J."""
CAREFUL_TIME_PRICE = 0.3
"""The same where a vessel is kept level [rad/s]: there the duration does not follow from the length, and the shortest
motions would take up to half as long again for a hundredth less length."""
DRIVING_TIME_PRICE = 0.3
"""The same of a base that drives [m/s]: a base that crawls saves harm at no length."""
_SLICE = 20
"""Evaluations of a descent between two looks at the clock."""
_HARDENINGS = 3
"""How often a descent that ends too close to an obstacle goes on with a heavier penalty, for `_MORE` evaluations."""
_MORE = 40
_FOR_CLEARANCE = 1
"""How often for more clearance than the motion must have."""
_WORKERS = 2
_KEPT = 4
"""One of so many descents goes on to the next stage, and at least `_LEAST` do."""
_LEAST = 2
_COARSE_SHARE, _MIDDLE_SHARE = 0.3, 0.6
"""Parts of the time after which the coarse and the middle stage begin no more descents."""
_UNTIMED_BENDS, _UNTIMED_REFINEMENTS = 4, 2
"""Bends of starts and refinements in a round that no clock limits."""
_MOST_BENDS, _MOST_REFINEMENTS = 5000, 2000
_PROMISING = (1.2, 1.05)
"""A refinement goes on after its coarse and its middle stage if J is at most so many times that of the best curve."""
_NARROW = (0.1, 1.0)
"""Least and greatest size of the bend of a refinement [rad]."""
_WIDE = (0.3, 1.5)
"""The same of the bends of starts, of which `_WIDE_BENDS` add up."""
_WIDE_BENDS = 2
_RESAMPLED = 64
"""Points of a curve from which the next descent begins."""


def time_price(*, careful: bool) -> float:
    """Return the cost of a second of motion on top of J [rad/s], greater where a vessel is kept level."""
    return CAREFUL_TIME_PRICE if careful else TIME_PRICE


@final
@dataclass(frozen=True)
class Stage:
    """Resolution and length of a descent.

    | field       | meaning                                        |
    |-------------|------------------------------------------------|
    | controls    | control points                                 |
    | density     | samples between two knots                      |
    | rough       | whether impacts are in single precision        |
    | evaluations | of the motion and its gradient, at most        |
    | slosh       | whether it counts how a carried liquid sloshes |
    """

    controls: int
    density: int
    rough: bool
    evaluations: int
    slosh: bool = True


# Where a motion should go shows sooner without sloshing, which a few samples do not resolve.
COARSE, MIDDLE, FINE = Stage(12, 3, True, 40, slosh=False), Stage(16, 5, True, 60), Stage(24, 6, True, 160)
LONG = Stage(12, 3, True, 200)
"""Replaces the middle stage where evaluations are expensive: it costs less than half as much."""


@final
@dataclass(frozen=True)
class DescentSettings:
    """Work of a round of descents.

    | field       | meaning                                                                          |
    |-------------|----------------------------------------------------------------------------------|
    | screens     | whether starts descend coarsely first, and only the better ones go on            |
    | bends       | wide bends of starts besides; as many as there is time for if None               |
    | middle      | second stage                                                                     |
    | fine        | descents that end finely, at least; with 0, coarse curves are the result         |
    | hurries     | whether curves of the second stage are results, too, before the finer ones       |
    | refinements | at most; as many as there is time for if None                                    |
    """

    screens: bool = True
    bends: int | None = None
    middle: Stage = MIDDLE
    fine: int = 2
    hurries: bool = False
    refinements: int | None = None


@final
@dataclass(frozen=True, eq=False)
class Start:
    """A path to descend from, and the lengths at both ends where the spheres are too close to obstacles [rad].

    `curve` is the curve whose samples the path is, if it has descended before.
    """

    path: Path
    tight_start: float = 0.0
    tight_end: float = 0.0
    curve: Spline | None = None
    arrival: int = 0
    """Which of several ways to a goal the path takes."""


@final
@dataclass(frozen=True, eq=False)
class DescentResult:
    """A free curve, its J as the descent computes it, and the start it descended from."""

    curve: Spline
    value: float
    start: Start


@final
@dataclass
class Effort:
    """Number of descents that have ended."""

    descents: int = 0


@final
@dataclass(frozen=True, eq=False)
class MotionDescents:
    """Descends from paths.

    Args:
        space: Cost and clearance, with slopes of states.
        velocity: Limits of the joints [rad/s or m/s].
        acceleration: Limits of the joints [rad/s^2 or m/s^2].
        is_free: Whether a curve that descended from a start is free of collision.
        has_clearance: Whether it keeps the clearance that is wanted; None if any will do.
        settings: Work of a round.
        felt: Limits on the acceleration that a carried object feels.
        counts_points: Whether the cost is summed over the samples of the motion.
        careful: Whether a vessel is kept level.
        projected: Moves configurations to where bounds hold; None without bounds.
        effort: Counts the descents of all rounds.
    """

    space: _native.Space
    velocity: Float[Array, " nq"]
    acceleration: Float[Array, " nq"]
    is_free: Callable[[Spline, Start], bool]
    has_clearance: Callable[[Spline, Start], bool] | None = None
    settings: DescentSettings = DescentSettings()
    felt: Sequence[_native.FeltLimit] = ()
    counts_points: bool = False
    careful: bool = False
    projected: Callable[[Float[Array, "n nq"]], Float[Array, "n nq"]] | None = None
    effort: Effort = field(default_factory=Effort)

    @property
    def time_price(self) -> float:
        """Cost of a second of motion on top of J [rad/s]."""
        return time_price(careful=self.careful)

    def round(
        self, starts: Sequence[Start], budget: Budget, rng: np.random.Generator, best: Sequence[DescentResult] = ()
    ) -> Iterator[DescentResult]:
        """Yield free curves that descended from starts, then refinements of the best of all.

        Without a time limit the number of descents is fixed, and the result does not depend on the clock.

        Args:
            starts: Paths to descend from.
            budget: Time of the round.
            rng: For bends.
            best: Results of earlier rounds, which refinements may begin with.
        """
        with ThreadPoolExecutor(_WORKERS) as pool:
            yield from _Round(self, starts, budget, rng, pool, list(best)).run()

    def descended(self, start: Start, stage: Stage, budget: Budget) -> _native.MotionDescent | None:
        """Descend from a path for one stage; None if the budget is over."""
        if budget.over:
            return None
        descent = _native.MotionDescent(
            self.space,
            path=np.ascontiguousarray(start.path.q if start.curve is None else _fitted(start.curve, stage.controls)),
            fitted=start.curve is not None,
            velocity=self.velocity,
            acceleration=self.acceleration,
            controls=stage.controls,
            density=stage.density,
            rough=stage.rough,
            time_price=self.time_price,
            tight_start=start.tight_start,
            tight_end=start.tight_end,
            felt=self.felt,
            slosh=stage.slosh,
            points=float(grid_points(stage.controls)) if self.counts_points else 1.0,
        )
        _go_on(descent, stage.evaluations, budget)
        return descent

    def first(self, start: Start, budget: Budget) -> DescentResult | None:
        """Descend coarsely from one path; None if the curve is not free, at the end or half-way already."""
        half = COARSE.evaluations // 2
        descent = self.descended(start, replace(COARSE, evaluations=half), budget)
        if descent is None or not self.is_free(Spline(descent.controls), start):
            return None
        _go_on(descent, COARSE.evaluations - half, budget)
        curve = Spline(descent.controls)
        return DescentResult(curve, descent.value, start) if self.is_free(curve, start) else None

    def finished(self, start: Start, stage: Stage, budget: Budget) -> DescentResult | None:
        """Descend, with a heavier penalty while the curve is too close to obstacles; None if it stays so."""
        descent = self.descended(start, stage, budget)
        if descent is None:
            return None
        for hardening in range(_HARDENINGS + 1):
            curve = Spline(descent.controls)
            enough = self.has_clearance is None or hardening >= _FOR_CLEARANCE or self.has_clearance(curve, start)
            if enough and self.is_free(curve, start):
                return DescentResult(curve, descent.value, start)
            if hardening < _HARDENINGS:
                descent.harden()
                _go_on(descent, _MORE, budget)
        return None


@dataclass
class _Round:
    """Descents from coarse to fine, then refinements."""

    descents: MotionDescents
    starts: Sequence[Start]
    budget: Budget
    rng: np.random.Generator
    pool: Executor
    results: list[DescentResult]

    def run(self) -> Iterator[DescentResult]:
        settings, budget = self.descents.settings, self.budget
        jobs, coarse, before = list(self.starts), list[DescentResult](), len(self.results)
        if settings.screens and jobs:
            began, seconds = budget.elapsed, budget.remaining_seconds
            with budget.share(_COARSE_SHARE * seconds) as part:
                values = self._coarse(part, coarse)
            with budget.share(began + _MIDDLE_SHARE * seconds - budget.elapsed) as part:
                values = self._descended([start for _, start in _better(values)], settings.middle, part, coarse)
            jobs = [start for _, start in _better(values)]
        jobs = jobs[: max(settings.fine, len(jobs) if settings.screens else 0)]
        if settings.hurries:
            for k, found in self._finished(jobs, settings.middle):
                jobs[k] = _from_curve(jobs[k], found.curve)
                yield found
        yield from (found for _, found in self._finished(jobs, FINE))
        if len(self.results) == before:  # coarse values are guesses, so coarse curves serve only where no fine one does
            self.results += sorted(coarse, key=_value)[:_LEAST]
            yield from self.results[before:]
        most = _MOST_REFINEMENTS if budget.timed else _UNTIMED_REFINEMENTS
        for _ in range(0, most if settings.refinements is None else settings.refinements, _WORKERS):
            if budget.over or not self.results:
                return
            yield from self._refined()

    def _coarse(self, budget: Budget, free: list[DescentResult]) -> list[tuple[float, Start]]:
        """Descend coarsely from all starts and from wide bends of them."""
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
        """Return values and curves as new starts; add those that are free to `free`."""
        ended: list[tuple[float, Start]] = []
        done = self._each(lambda start: self.descents.descended(start, stage, budget), starts)
        for descent, start in zip(done, starts, strict=True):
            if descent is None:
                continue
            curve = Spline(descent.controls)
            ended.append((descent.value, _from_curve(start, curve)))
            if self.descents.is_free(curve, start):
                free.append(DescentResult(curve, descent.value, start))
        self.descents.effort.descents += len(starts)
        return ended

    def _finished(self, starts: Sequence[Start], stage: Stage) -> Iterator[tuple[int, DescentResult]]:
        """Yield free curves that keep their clearance where there is room, with the index of their start."""
        if self.descents.settings.fine:
            done = self._each(lambda start: self.descents.finished(start, stage, self.budget), list(starts))
            for k, one in enumerate(done):
                self.descents.effort.descents += 1
                if one is not None:
                    self.results.append(one)
                    yield k, one

    def _each(self, do: Callable[[Start], _T], starts: Sequence[Start]) -> Iterator[_T]:
        """Do something with each start side by side; a single one does not wait for a thread to begin."""
        return map(do, starts) if len(starts) == 1 else self.pool.map(do, starts)

    def _refined(self) -> Iterator[DescentResult]:
        """Bend two of the best curves at random and let them descend as long as they promise to become better."""
        settings = self.descents.settings
        best = sorted(self.results, key=_value)[:_WORKERS]
        chosen = [best[0] if self.rng.uniform() < 0.5 else best[-1] for _ in range(_WORKERS)]
        jobs, free = [self._bent(_resampled(one.curve), one.start, _NARROW) for one in chosen], list[DescentResult]()
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
        """Bend a curve at a random place, by a random size and in a random direction."""
        s = np.linspace(0.0, 1.0, len(q))[:, None]
        centre, width = self.rng.uniform(0.1, 0.9), self.rng.uniform(0.15, 0.8)
        direction = self.rng.normal(size=q.shape[1])
        least, most = sizes
        size = least * (most / least) ** self.rng.uniform() / np.linalg.norm(direction)
        bump = np.maximum(0.0, 1.0 - ((s - centre) / width) ** 2) ** 2 * np.minimum(1.0, 8.0 * s * (1.0 - s))
        bent = q + size * bump * direction
        if self.descents.projected is not None:  # random bends would tilt what is kept level
            bent[1:-1] = self.descents.projected(bent[1:-1])
        return replace(start, path=Path(bent), curve=None)


def _from_curve(start: Start, curve: Spline) -> Start:
    return replace(start, path=Path(_resampled(curve)), curve=curve)


def _value(result: DescentResult) -> float:
    return result.value


def _better(jobs: Sequence[tuple[float, Start]]) -> Sequence[tuple[float, Start]]:
    """Return the part of descents that goes on, the best first."""
    return sorted(jobs, key=lambda job: job[0])[: max(_LEAST, len(jobs) // _KEPT)]


def _resampled(curve: Spline) -> Float[Array, "n nq"]:
    u = np.linspace(0.0, len(curve.controls) - 3.0, _RESAMPLED)
    q = _native.spline(np.ascontiguousarray(curve.controls), u)[0]
    q[0], q[-1] = curve.controls[0], curve.controls[-1]
    return q


def _fitted(curve: Spline, controls: int) -> Float[Array, "control nq"]:
    """Return the control points of the same curve, or of one that meets it at all knots, with so many."""
    if len(curve.controls) == controls:
        return curve.controls
    fitted = Spline.through(curve.at(np.linspace(0.0, curve.spans, controls - 2))).controls.copy()
    fitted[0], fitted[-1] = curve.controls[0], curve.controls[-1]  # to the last bit
    return fitted


def _go_on(descent: _native.MotionDescent, evaluations: int, budget: Budget) -> None:
    """Let a descent evaluate its motion so many times more, as far as the budget lasts."""
    done = 0
    while done < evaluations and not budget.over:
        if descent.run(_SLICE, budget.remaining_seconds) < _SLICE:
            return
        done += _SLICE

"""Smooth motions from paths: control points of a spline descend along J of the motion as it will be executed.

The work is done in the core (`search/motion_descent.hpp`), where the speed profile is part of the gradient. Which
valley has the best motion does not show in the paths: descents from all of them and from many wide bends of them go
from coarse to fine, side by side, and only the better ones go on. What time is left is for hops: the best motions, bent
at random, descend again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.resampling import evenly
from graceful_plan.timing.spline import Spline, grid_points

Array = np.ndarray

TIME_PRICE = 0.05
"""What a second of motion counts on top of J [rad/s]: it decides between motions of about the same J."""
CAREFUL_TIME_PRICE = 0.3
"""The same where something full is carried [rad/s]: how long it takes does not follow from how far it is any more, and
motions of the shortest paths would take up to half as long again for a hundredth less length."""
DRIVING_TIME_PRICE = 0.3
"""The same of a base that drives [m/s], for which being slow costs no length and spares harm: without it, it crawls."""
_ROUND = 20
"""Evaluations of a descent between two looks at the clock."""
_HARDENINGS = 3
"""How often a descent that ends too close to something is pressed harder away from it, for `_MORE` evaluations each."""
_MORE = 40
_FOR_ROOM = 1
"""How often for more room than has to be."""
_WORKERS = 2
_UNTIMED_HOPS = 4
"""Hops where no clock limits them."""
_GOES_ON = 4
"""One of so many coarse descents goes on, and one of so many of these descends finely; at least `_LEAST` do."""
_LEAST = 4
_COARSE_SHARE = 0.3
"""Of the time, for coarse descents."""
_MIDDLE_SHARE = 0.5
"""Of what is left then, at most for the next part; where evaluations are dear, nothing would land otherwise."""
_UNTIMED_BENDS = 8
"""Wide bends where no clock limits them."""
_MOST_BENDS = 5000
_MOST_HOPS = 2000
_PROMISING = (1.2, 1.05)
"""After its coarse and its middle part, a hop goes on if J is no more than so many times that of the best."""
_HOP = (0.1, 1.0)
"""Least and greatest size of the bend of a hop [rad]."""
_WIDE = (0.3, 1.5)
"""The same of the bends of paths that coarse descents begin with."""
_WIDE_BENDS = 2
"""Bends that are added up in one of these."""
_RESAMPLED = 64
"""Points of a curve from which the next descent begins."""


def time_price(*, careful: bool) -> float:
    """Return what a second of motion counts on top of J [rad/s]; careful is who carries something full."""
    return CAREFUL_TIME_PRICE if careful else TIME_PRICE


@final
@dataclass(frozen=True)
class Stage:
    """How finely a motion descends, and how long.

    | field       | meaning                                        |
    |-------------|------------------------------------------------|
    | controls    | control points                                 |
    | density     | samples between two knots                      |
    | rough       | whether impacts are in single precision        |
    | evaluations | of the motion and its gradient, at most        |
    """

    controls: int
    density: int
    rough: bool
    evaluations: int

    @property
    def work(self) -> int:
        """States that all of its evaluations look at."""
        return self.evaluations * (self.density * (self.controls - 3) + 1)


COARSE, MIDDLE, FINE = Stage(12, 3, True, 40), Stage(16, 5, True, 60), Stage(24, 6, True, 160)
LONG = Stage(12, 3, True, 200)
"""Instead of the middle one where states are dear: these many evaluations cost less than half of what it does."""


@final
@dataclass(frozen=True)
class Effort:
    """How much a search for motions takes on.

    | field   | meaning                                                                          |
    |---------|----------------------------------------------------------------------------------|
    | screens | whether starts descend coarsely first, and only the better ones go on            |
    | bends   | wide bends of starts that do so, too; as many as there is time for if None       |
    | middle  | what the better ones go on with                                                  |
    | fine    | how many then descend finely, at least; with none, coarse curves are the result  |
    | hops    | how many hops at most; as many as there is time for if None                      |
    """

    screens: bool = True
    bends: int | None = None
    middle: Stage = MIDDLE
    fine: int = 2
    hops: int | None = None


@final
@dataclass(frozen=True, eq=False)
class Start:
    """A path to descend from, and the parts of its length at both ends that are tight for the spheres [rad].

    If it is that of a curve that has descended already, the curve.
    """

    path: Path
    tight_start: float = 0.0
    tight_end: float = 0.0
    curve: Spline | None = None


@final
@dataclass(frozen=True, eq=False)
class Landed:
    """A curve that a descent ended with, J of it as the descent knows it, and which start it came from."""

    curve: Spline
    value: float
    start: int


@final
@dataclass(frozen=True, eq=False)
class MotionDescents:
    """Descends from paths.

    Args:
        space: Cost and clearance, with slopes of states.
        velocity: Limits of the joints [rad/s or m/s].
        acceleration: Limits of the joints [rad/s^2 or m/s^2].
        is_free: Whether nothing is hit along a curve that came from some start.
        has_room: Whether it passes everything with room to spare; None if that does not matter.
        effort: How much of what there is to do.
        felt: Limits on what is felt where something is carried.
        counts_points: Whether the cost is summed over the samples of the motion.
        careful: Whether something full is carried.
    """

    space: _native.Space
    velocity: Float[Array, " nq"]
    acceleration: Float[Array, " nq"]
    is_free: Callable[[Spline, Start], bool]
    has_room: Callable[[Spline, Start], bool] | None = None
    effort: Effort = Effort()
    felt: Sequence[_native.FeltLimit] = ()
    counts_points: bool = False
    careful: bool = False

    @property
    def time_price(self) -> float:
        """What a second of motion counts on top of J [rad/s]."""
        return time_price(careful=self.careful)

    def run(
        self, starts: Sequence[Start], budget: Budget, rng: np.random.Generator, *, raw: int | None = None
    ) -> list[Landed]:
        """Descend from all starts and hop, as far as the time allows; return free curves, the best first.

        With iterations, the number of hops is fixed and, unless a time limit ends it, the result does not depend on the
        clock.

        Args:
            starts: What to descend from.
            budget: Time for it.
            rng: For bends.
            raw: How many of the last starts wide bends begin with; all by default.
        """
        with ThreadPoolExecutor(_WORKERS) as pool:
            return _Descending(self, starts, budget, rng, pool, raw or len(starts)).run()

    def descended(self, start: Start, stage: Stage, budget: Budget) -> _native.MotionDescent | None:
        """Descend from a path for one stage; None if there was no time for it."""
        if _out(budget):
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
            points=float(grid_points(stage.controls)) if self.counts_points else 1.0,
        )
        go_on(descent, stage.evaluations, budget)
        return descent

    def landed(self, start: Start, index: int, budget: Budget) -> Landed | None:
        """Descend finely and press away from what is too close; None if that does not help."""
        descent = self.descended(start, FINE, budget)
        if descent is None:
            return None
        for hardening in range(_HARDENINGS + 1):
            curve = Spline(descent.controls)
            pressed = hardening >= _FOR_ROOM
            if self.is_free(curve, start) and (pressed or self.has_room is None or self.has_room(curve, start)):
                return Landed(curve, descent.value, index)
            if hardening < _HARDENINGS:
                descent.harden()
                go_on(descent, _MORE, budget)
        return None


@dataclass
class _Descending:
    """Descents from coarse to fine, then hops."""

    descents: MotionDescents
    starts: Sequence[Start]
    budget: Budget
    rng: np.random.Generator
    pool: ThreadPoolExecutor
    raw: int
    """How many of the last starts wide bends begin with."""
    began: float = field(init=False)
    """Reading of the budget's clock [s]."""
    found: list[Landed] = field(default_factory=list)
    spare: list[Landed] = field(default_factory=list)
    """Free curves of coarse descents: their J is a guess, so that they count only where nothing has landed."""

    def __post_init__(self) -> None:
        self.began = self.budget.elapsed

    def run(self) -> list[Landed]:
        effort, jobs = self.descents.effort, [(0.0, start, k) for k, start in enumerate(self.starts)]
        fine = effort.fine
        if effort.screens:
            jobs = self._coarse()
            jobs = self._descended(_plain(jobs[: self._worth(len(jobs))]), effort.middle)
            fine = max(fine, len(jobs) // _GOES_ON) if fine else 0
        self._land(jobs[:fine])
        most = _MOST_HOPS if self.budget.timed else _UNTIMED_HOPS
        for _ in range(0, most if effort.hops is None else effort.hops, _WORKERS):
            if _out(self.budget) or not self._elite():
                break
            self._hop()
        return sorted(self.found or self.spare, key=lambda one: one.value)

    def _worth(self, coarse: int) -> int:
        """How many of so many coarse descents go on: no more than leave time for some that descend finely."""
        most = max(_LEAST, coarse // _GOES_ON)
        if not self.budget.timed or coarse == 0:
            return most
        each = self.descents.effort.middle.work / COARSE.work * (self.budget.elapsed - self.began) / coarse
        fits = _MIDDLE_SHARE * self.budget.remaining_seconds / max(each, 1e-9)
        return int(np.clip(fits, min(_WORKERS, most), most))

    def _coarse(self) -> list[tuple[float, Start, int]]:
        """Descend coarsely from all starts and from wide bends of them; the best first."""
        until = self.budget.elapsed + _COARSE_SHARE * self.budget.remaining_seconds
        jobs = self._descended([(start, k) for k, start in enumerate(self.starts)], COARSE)
        bends = self.descents.effort.bends
        most = bends if bends is not None else _MOST_BENDS if self.budget.timed else _UNTIMED_BENDS
        for _ in range(0, most if self.starts else 0, _WORKERS):
            if self.budget.elapsed >= until or _out(self.budget):
                break
            chosen = self.rng.integers(len(self.starts) - self.raw, len(self.starts), size=_WORKERS).tolist()
            jobs += self._descended([(self._widely_bent(k), k) for k in chosen], COARSE)
        return sorted(jobs, key=lambda job: job[0])

    def _descended(self, jobs: Sequence[tuple[Start, int]], stage: Stage) -> list[tuple[float, Start, int]]:
        """Return values, curves as paths and where they came from, the best first; keep what is free already."""
        ended: list[tuple[float, Start, int]] = []
        done = self.pool.map(lambda job: self.descents.descended(job[0], stage, self.budget), jobs)
        for descent, (start, k) in zip(done, jobs, strict=True):
            if descent is None:
                continue
            curve = Spline(descent.controls)
            ended.append((descent.value, replace(start, path=Path(_resampled(curve)), curve=curve), k))
            if self.descents.is_free(curve, start):
                self.spare.append(Landed(curve, descent.value, k))
        return sorted(ended, key=lambda one: one[0])

    def _land(self, jobs: Sequence[tuple[float, Start, int]]) -> None:
        done = self.pool.map(lambda job: self.descents.landed(job[1], job[2], self.budget), jobs)
        self.found += [one for one in done if one is not None]

    def _hop(self) -> None:
        """Bend some of the best motions, and see whether they descend to better ones."""
        elite = self._elite()
        best = elite[0].value
        chosen = [elite[0] if self.rng.uniform() < 0.5 else elite[-1] for _ in range(_WORKERS)]
        jobs = [(self._bent(_resampled(one.curve), one.start, _HOP), one.start) for one in chosen]
        for stage, most in zip((COARSE, self.descents.effort.middle), _PROMISING, strict=True):
            kept = [one for one in self._descended(jobs, stage) if one[0] < most * best]
            jobs = [(start, k) for _, start, k in kept]
            if not jobs:
                return
        self._land([(0.0, start, k) for start, k in jobs[: self.descents.effort.fine]])

    def _elite(self) -> list[Landed]:
        """What hops begin with: the best that have landed, or of coarse descents where none are to land."""
        found = self.found if self.descents.effort.fine else self.spare
        return sorted(found, key=lambda one: one.value)[:_WORKERS]

    def _widely_bent(self, index: int) -> Start:
        q = evenly(self.starts[index].path.q, _RESAMPLED)
        for _ in range(_WIDE_BENDS):
            q = self._bent(q, index, _WIDE).path.q
        return replace(self.starts[index], path=Path(q))

    def _bent(self, q: Float[Array, "n nq"], index: int, sizes: tuple[float, float]) -> Start:
        """Bend a curve at a random place, by a random size and in a random direction."""
        s = np.linspace(0.0, 1.0, len(q))[:, None]
        centre, width = self.rng.uniform(0.1, 0.9), self.rng.uniform(0.15, 0.8)
        direction = self.rng.normal(size=q.shape[1])
        least, most = sizes
        size = least * (most / least) ** self.rng.uniform() / np.linalg.norm(direction)
        bump = np.maximum(0.0, 1.0 - ((s - centre) / width) ** 2) ** 2 * np.minimum(1.0, 8.0 * s * (1.0 - s))
        start = self.starts[index]
        return Start(Path(q + size * bump * direction), start.tight_start, start.tight_end)


def _plain(jobs: Sequence[tuple[float, Start, int]]) -> list[tuple[Start, int]]:
    return [(start, k) for _, start, k in jobs]


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


def go_on(descent: _native.MotionDescent, evaluations: int, budget: Budget) -> None:
    """Let a descent evaluate its motion so many times more, as far as the budget lasts."""
    done = 0
    while done < evaluations and not _out(budget):
        if descent.run(_ROUND, budget.remaining_seconds) < _ROUND:
            return
        done += _ROUND


def _out(budget: Budget) -> bool:
    return budget.elapsed >= budget.time_limit or budget.cancelled()

"""Smooth motions from paths: control points of a spline descend along J of the motion as it will be executed.

The work is done in the core (`search/motion_descent.hpp`), where the speed profile is part of the gradient. Descents
from several paths, on several numbers of control points, run side by side; those that fall behind are given up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.timing.spline import Spline

Array = np.ndarray

TIME_PRICE = 0.05
"""What a second of motion counts on top of J [rad/s]: it decides between motions of about the same J."""
CONTROLS = (16, 24, 12, 32)
"""Numbers of control points that are tried for each path, one after the other."""
_DENSITY = 6
"""Samples between two knots."""
_ROUND = 25
"""Evaluations of a descent between two looks at the others."""
_PATIENCE = 40
"""Evaluations after which a descent is compared with the best one."""
_HOPELESS = 1.25
"""A descent is given up if its J is so many times that of the best one then."""
_MOST = 300
"""Evaluations of one descent."""
_HARDENINGS = 3
"""How often a descent that ends too close to something is pressed harder away from it, for `_MORE` evaluations each."""
_MORE = 40
_WORKERS = 2
_UNTIMED = 12
"""Descents where no clock limits them."""


@final
@dataclass(frozen=True, eq=False)
class Start:
    """A path to descend from, and the parts of its length at both ends that are tight for the spheres [rad]."""

    path: Path
    tight_start: float = 0.0
    tight_end: float = 0.0


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
    """

    space: _native.Space
    velocity: Float[Array, " nq"]
    acceleration: Float[Array, " nq"]
    is_free: Callable[[Spline, Start], bool]

    def run(self, starts: Sequence[Start], budget: Budget) -> list[Landed]:
        """Descend from all starts, as far as the time allows; return free curves, the best first.

        Without a time limit, the number of descents is fixed and the result does not depend on the clock.
        """
        jobs = [(k, controls) for controls in CONTROLS for k in range(len(starts))]
        timed = bool(np.isfinite(budget.time_limit))
        if not timed:
            jobs = jobs[:_UNTIMED]
        found: list[Landed] = []
        best = _Least()

        def work(job: tuple[int, int]) -> Landed | None:
            return self._descended(starts[job[0]], job, best if timed else _Least(), budget)

        with ThreadPoolExecutor(_WORKERS) as pool:
            found += [one for one in pool.map(work, jobs) if one is not None]
        return sorted(found, key=lambda one: one.value)

    def _descended(self, start: Start, job: tuple[int, int], best: _Least, budget: Budget) -> Landed | None:
        if _out(budget):
            return None
        descent = _native.MotionDescent(
            self.space,
            path=np.ascontiguousarray(start.path.q),
            velocity=self.velocity,
            acceleration=self.acceleration,
            controls=job[1],
            density=_DENSITY,
            time_price=TIME_PRICE,
            tight_start=start.tight_start,
            tight_end=start.tight_end,
        )
        for done in self._rounds(descent, _MOST, budget):
            if done >= _PATIENCE and descent.value > _HOPELESS * best.value:
                return None
        for _ in range(_HARDENINGS):
            curve = Spline(descent.controls)
            if self.is_free(curve, start):
                best.value = min(best.value, descent.value)
                return Landed(curve, descent.value, job[0])
            descent.harden()
            for _ in self._rounds(descent, _MORE, budget):
                pass
        return None

    def _rounds(self, descent: _native.MotionDescent, most: int, budget: Budget) -> Iterator[int]:
        done = 0
        while done < most and not _out(budget):
            now = descent.run(_ROUND, budget.remaining_seconds)
            done += _ROUND
            yield done
            if now < _ROUND:
                return


@dataclass
class _Least:
    value: float = np.inf


def _out(budget: Budget) -> bool:
    return budget.elapsed >= budget.time_limit or budget.cancelled()

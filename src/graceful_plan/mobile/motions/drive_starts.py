"""Initial curves for descents of a base: short smooth ones, and variants that are slower or change the arm posture.

The queue is ordered by J before the descent, so the most promising curves descend first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.mobile.motions.carry_postures import with_posture
from graceful_plan.mobile.motions.rolling_spline import RollingSpline
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import COARSE, MIDDLE, DescentResult, MotionDescents, Start
from graceful_plan.planners.planner import Budget

_LOOK = replace(MIDDLE, evaluations=0)
"""Evaluates J of a curve without descending."""
_PACES = ((0.6, 0.0, 1.0), (0.35, 0.0, 1.0), (0.25, 0.0, 0.3), (0.25, 0.2, 0.5), (0.25, 0.4, 0.7))
"""Initial shares of the speed for curves that collide with a moving entity, and the part of the curve they hold for."""
_KEPT = 2
"""Number of variants of a curve that are kept."""
_POINTS = 64
"""Number of points of a curve when it is converted to a path."""


@final
class DriveStarts:
    """Queue of curves for descents.

    Args:
        descents: Descents that the curves are for.
    """

    def __init__(self, descents: MotionDescents) -> None:
        self._descents = descents
        self._waiting: list[tuple[float, Start]] = []
        self._tried: list[tuple[float, Start]] = []
        self._arms: list[Float[Array, " arm"]] = []

    def pose(self, best: Start, arms: Float[Array, "posture arm"]) -> Iterator[DescentResult]:
        """Add variants of the best curve with other arm postures; curves added later get these postures as well.

        Yields the collision-free curves with their J before the descent.
        """
        self._arms = list(arms) or self._arms
        for arm in arms:
            yield from self._look(_posed(best, arm), ())

    def add(self, start: Start) -> Iterator[DescentResult]:
        """Add a curve; yield its best variant, with J before the descent, if it is free."""
        yield from self._look(start, self._arms)

    def take(self, most: int, *, again: bool) -> list[Start]:
        """Take the curves with the least J. If none are left, `again` returns those that were taken before."""
        if again and not self._waiting:
            self._waiting, self._tried = self._tried, []
        taken, self._waiting = self._waiting[:most], self._waiting[most:]
        self._tried += taken
        return [start for _, start in taken]

    def _look(self, start: Start, arms: Sequence[Float[Array, " arm"]]) -> Iterator[DescentResult]:
        """Queue the best variants of a start in the order of J; yield the best if it is free."""
        looked = [found for one in (start, *(_posed(start, arm) for arm in arms)) if (found := self._value(one))]
        if not looked:
            return
        looked.sort(key=_value)
        _, best, gap = looked[0]
        if gap < 0.0:
            looked += [found for slower in _paced(best) if (found := self._value(slower))]
            looked.sort(key=_value)
        self._waiting += [(value, one) for value, one, _ in looked[:_KEPT]]
        self._waiting.sort(key=lambda one: one[0])
        value, best, gap = looked[0]
        if gap >= 0.0 and best.curve is not None and self._descents.is_free(best.curve, best):
            yield DescentResult(best.curve, value, best)

    def _value(self, start: Start) -> tuple[float, Start, float] | None:
        """Return J of a start before the descent, the start, and its clearance to moving entities."""
        descent = self._descents.descended(start, _LOOK, Budget())
        return None if descent is None else (descent.value, start, descent.gap)


def smooth(start: Start, descents: MotionDescents, budget: Budget) -> Start | None:
    """Return a start whose path is replaced by a coarsely descended curve; None if there is no time for it."""
    descent = descents.descended(start, COARSE, budget)
    if descent is None:
        return None
    curve = start.kind.curve(descent.controls)
    return replace(start, path=Path(curve.even(_POINTS)), curve=curve)


def _posed(start: Start, arm: Float[Array, " arm"]) -> Start:
    assert isinstance(start.curve, RollingSpline)
    curve = replace(start.curve, controls=with_posture(start.curve.controls, arm))
    return replace(start, path=Path(curve.even(_POINTS)), curve=curve)


def _paced(start: Start) -> Iterator[Start]:
    """Yield slower variants of a start."""
    assert isinstance(start.curve, RollingSpline)
    along = np.linspace(0.0, 1.0, len(start.curve.controls))
    for slow, begin, end in _PACES:
        controls = start.curve.controls.copy()
        controls[:, -1] = np.where((along >= begin) & (along <= end), np.log(slow), 0.0)
        yield replace(start, curve=replace(start.curve, controls=controls))


def _value(looked: tuple[float, Start, float]) -> float:
    return looked[0]

"""Curves of a base that descents begin with: short and smooth ones, also slower and with the arm in other postures.

They wait in the order of J as they are, so that those descend first that promise most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.mobile.motions.carry_postures import with_posture
from graceful_plan.mobile.motions.rolling_spline import RollingSpline
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import COARSE, MIDDLE, DescentResult, MotionDescents, Start
from graceful_plan.planners.planner import Budget

Array = np.ndarray

_LOOK = replace(MIDDLE, evaluations=0)
"""Tells J of a curve as it is."""
_PACES = ((0.6, 0.0, 1.0), (0.35, 0.0, 1.0), (0.25, 0.0, 0.3), (0.25, 0.2, 0.5), (0.25, 0.4, 0.7))
"""Initial shares of the speed for curves that collide with a moving entity, and the part of the curve they hold for."""
_KEPT = 2
"""Variants of a curve."""
_POINTS = 64
"""Of a curve, as a path."""


@final
class DriveStarts:
    """Curves that wait to descend.

    Args:
        descents: The descents they are for.
    """

    def __init__(self, descents: MotionDescents) -> None:
        self._descents = descents
        self._waiting: list[tuple[float, Start]] = []
        self._tried: list[tuple[float, Start]] = []
        self._arms: list[Float[Array, " arm"]] = []

    def pose(self, best: Start, arms: Float[Array, "posture arm"]) -> Iterator[DescentResult]:
        """Add variants of the best curve with other postures of the arm; curves that are added later get them, too.

        Yields curves that are free, with J as they are.
        """
        self._arms = list(arms) or self._arms
        for arm in arms:
            yield from self._look(_posed(best, arm), ())

    def add(self, start: Start) -> Iterator[DescentResult]:
        """Add a curve; yield its best variant if it is free, with J as it is."""
        yield from self._look(start, self._arms)

    def take(self, most: int, *, again: bool) -> list[Start]:
        """Take the curves with the least J. If none are left, `again` returns those that were taken before."""
        if again and not self._waiting:
            self._waiting, self._tried = self._tried, []
        taken, self._waiting = self._waiting[:most], self._waiting[most:]
        self._tried += taken
        return [start for _, start in taken]

    def _look(self, start: Start, arms: Sequence[Float[Array, " arm"]]) -> Iterator[DescentResult]:
        """Keep the best variants of a start in the order of J; yield the best if it is free."""
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
        """Return J of a start as it is, itself, and the gap that it keeps to entities that move."""
        descent = self._descents.descended(start, _LOOK, Budget())
        return None if descent is None else (descent.value, start, descent.gap)


def smooth(start: Start, descents: MotionDescents, budget: Budget) -> Start | None:
    """Return a start with a curve instead of a path, coarsely descended; None if there is no time for it."""
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
    """Yield a start at slower paces."""
    assert isinstance(start.curve, RollingSpline)
    along = np.linspace(0.0, 1.0, len(start.curve.controls))
    for slow, begin, end in _PACES:
        controls = start.curve.controls.copy()
        controls[:, -1] = np.where((along >= begin) & (along <= end), np.log(slow), 0.0)
        yield replace(start, curve=replace(start.curve, controls=controls))


def _value(looked: tuple[float, Start, float]) -> float:
    return looked[0]

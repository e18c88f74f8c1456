"""Smooth motions from paths: control points of a spline descend along J of the motion as it will be executed.

The core does the work (`search/motion_descent.hpp`), with the speed profile as part of the gradient. Here is one
descent; `descent_rounds` decides where descents begin and which of them go on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self, final, runtime_checkable

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.timing.blend import Curve
from graceful_plan.timing.spline import Spline, grid_points

Array = np.ndarray

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
_MOST_CONTROLS = 64
_FOR_CLEARANCE = 1
"""How often for more clearance than the motion must have."""


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


@runtime_checkable
class SmoothCurve(Curve, Protocol):
    """A curve that descents move by its control points."""

    @property
    def controls(self) -> Float[Array, "control column"]:
        """Its control points."""
        ...

    @property
    def samples(self) -> Float[Array, "n nq"]:
        """Configurations on it, close enough to check it by."""
        ...

    def even(self, n: int) -> Float[Array, "n nq"]:
        """Return configurations on it at even parameters, both ends among them."""
        ...

    def with_controls(self, n: int) -> Self:
        """Return the same curve, or one close to it, with so many control points."""
        ...


@runtime_checkable
class CurveKind(Protocol):
    """What kind of curve a descent moves."""

    @property
    def rolling(self) -> _native.Rolling | None:
        """How a base rolls along it; None for curves of joints."""
        ...

    def curve(self, controls: Float[Array, "control column"]) -> SmoothCurve:
        """Return the curve of control points."""
        ...


@final
@dataclass(frozen=True)
class JointCurves:
    """Splines through configurations, every joint for itself."""

    rolling: None = None

    def curve(self, controls: Float[Array, "control nq"]) -> Spline:
        """See `CurveKind`."""
        return Spline(controls)


@final
@dataclass(frozen=True, eq=False)
class Start:
    """A path to descend from, and the lengths at both ends where the spheres are too close to obstacles [rad].

    `curve` is the curve whose samples the path is, if it has descended before.
    """

    path: Path
    tight_start: float = 0.0
    tight_end: float = 0.0
    curve: SmoothCurve | None = None
    arrival: int = 0
    """Which of several ways to a goal the path takes."""
    kind: CurveKind = JointCurves()


@final
@dataclass(frozen=True, eq=False)
class DescentResult:
    """A free curve, its J as the descent computes it, and the start it descended from."""

    curve: SmoothCurve
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
        projected: Moves configurations to where bounds hold; None without bounds.
        time_price: Cost of a second of motion on top of J [rad/s].
        spacing: Greatest length of a path for each control point [rad or m]; None if it does not matter.
        effort: Counts the descents of all rounds.
    """

    space: _native.Space
    velocity: Float[Array, " nq"]
    acceleration: Float[Array, " nq"]
    is_free: Callable[[SmoothCurve, Start], bool]
    has_clearance: Callable[[SmoothCurve, Start], bool] | None = None
    settings: DescentSettings = DescentSettings()
    felt: Sequence[_native.FeltLimit] = ()
    counts_points: bool = False
    projected: Callable[[Float[Array, "n nq"]], Float[Array, "n nq"]] | None = None
    time_price: float = TIME_PRICE
    spacing: float | None = None
    effort: Effort = field(default_factory=Effort)

    def controls(self, start: Start, stage: Stage) -> int:
        """Return the number of control points: as many as a stage has, more for a long path."""
        if self.spacing is None:
            return stage.controls
        wanted = int(np.ceil(start.path.length / self.spacing)) + 3
        return int(np.clip(wanted, stage.controls, _MOST_CONTROLS))

    def descended(self, start: Start, stage: Stage, budget: Budget) -> _native.MotionDescent | None:
        """Descend from a path for one stage; None if the budget is over."""
        if budget.over:
            return None
        controls = self.controls(start, stage)
        fitted = None if start.curve is None else start.curve.with_controls(controls).controls
        descent = _native.MotionDescent(
            self.space,
            path=np.ascontiguousarray(start.path.q if fitted is None else fitted),
            fitted=fitted is not None,
            velocity=self.velocity,
            acceleration=self.acceleration,
            controls=controls,
            density=stage.density,
            rough=stage.rough,
            time_price=self.time_price,
            tight_start=start.tight_start,
            tight_end=start.tight_end,
            felt=self.felt,
            slosh=stage.slosh,
            points=float(grid_points(controls)) if self.counts_points else 1.0,
            rolling=start.kind.rolling,
        )
        _go_on(descent, stage.evaluations, budget)
        return descent

    def first(self, start: Start, budget: Budget) -> DescentResult | None:
        """Descend coarsely from one path; None if the curve is not free, at the end or half-way already."""
        half = COARSE.evaluations // 2
        descent = self.descended(start, replace(COARSE, evaluations=half), budget)
        if descent is None or not self.is_free(start.kind.curve(descent.controls), start):
            return None
        _go_on(descent, COARSE.evaluations - half, budget)
        curve = start.kind.curve(descent.controls)
        return DescentResult(curve, descent.value, start) if self.is_free(curve, start) else None

    def finished(self, start: Start, stage: Stage, budget: Budget) -> DescentResult | None:
        """Descend, with a heavier penalty while the curve is too close to obstacles; None if it stays so.

        Where it leads into an entity that moves, the penalty becomes heavier, too, but it is a result if it stays so.
        """
        descent = self.descended(start, stage, budget)
        if descent is None:
            return None
        for hardening in range(_HARDENINGS + 1):
            curve = start.kind.curve(descent.controls)
            enough = self.has_clearance is None or hardening >= _FOR_CLEARANCE or self.has_clearance(curve, start)
            passes = hardening == _HARDENINGS or descent.gap > 0.0
            if enough and passes and self.is_free(curve, start):
                return DescentResult(curve, descent.value, start)
            if hardening < _HARDENINGS:
                descent.harden()
                _go_on(descent, _MORE, budget)
        return None


def _go_on(descent: _native.MotionDescent, evaluations: int, budget: Budget) -> None:
    """Let a descent evaluate its motion so many times more, as far as the budget lasts."""
    done = 0
    while done < evaluations and not budget.over:
        if descent.run(_SLICE, budget.remaining_seconds) < _SLICE:
            return
        done += _SLICE

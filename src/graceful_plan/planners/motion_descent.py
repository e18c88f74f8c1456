"""Smooth motions from paths: gradient descent of a spline's control points along J of the timed motion.

The core implements it (`search/motion_descent.hpp`); the gradient includes the speed profile. This module runs single
descents; `descent_rounds` selects their starts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self, final, runtime_checkable

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.timing.blend import Curve
from graceful_plan.timing.spline import Spline, grid_points

TIME_PRICE = 0.05
"""Cost per second of motion in addition to J [rad/s]; it decides between motions of about the same J."""
LEVEL_TIME_PRICE = 0.3
"""Cost per second of motion if a vessel has to stay level [rad/s].

The duration then does not follow from the length: the shortest motions would take up to 50 % longer for 1 % less
length."""
DRIVING_TIME_PRICE = 0.3
"""Cost per second of motion for a mobile base [m/s]; without it, crawling would reduce impact at no cost in length."""
_SLICE = 20
"""Evaluations of a descent between two readings of the clock."""
_HARDENINGS = 3
"""Largest number of rounds with a heavier penalty, each of `_MORE` evaluations, if a curve is close to an obstacle."""
_MORE = 40
_MOST_CONTROLS = 64
_FOR_CLEARANCE = 1
"""Number of these rounds for clearance beyond the required margin."""


def time_price(*, careful: bool) -> float:
    """Return the cost per second of motion in addition to J [rad/s]; `careful`: a vessel has to stay level."""
    return LEVEL_TIME_PRICE if careful else TIME_PRICE


@final
@dataclass(frozen=True)
class Stage:
    """Resolution and length of a descent.

    | field       | meaning                                        |
    |-------------|------------------------------------------------|
    | controls    | number of control points                       |
    | density     | samples between two knots                      |
    | rough       | whether impacts are in single precision        |
    | evaluations | largest number of evaluations with gradient    |
    | slosh       | whether sloshing of a carried liquid counts    |
    """

    controls: int
    density: int
    rough: bool
    evaluations: int
    slosh: bool = True


# The coarse stage ignores sloshing: its few samples do not resolve it, and descents converge faster without.
COARSE, MIDDLE, FINE = Stage(12, 3, True, 40, slosh=False), Stage(16, 5, True, 60), Stage(24, 6, True, 160)
LONG = Stage(12, 3, True, 200)
"""Replacement of the middle stage if evaluations are expensive; it takes less than half the time."""


@final
@dataclass(frozen=True)
class DescentSettings:
    """Amount of work in a round of descents; see `descent_rounds` for the terms.

    | field       | meaning                                                                          |
    |-------------|----------------------------------------------------------------------------------|
    | screens     | whether starts descend coarsely first, and only the better ones proceed          |
    | bends       | number of additional starts with wide bends; None: limited by time               |
    | middle      | second stage                                                                     |
    | fine        | number of fine descents; 0: coarse curves are the result                         |
    | hurries     | whether curves of the second stage are also results, before the fine ones        |
    | refinements | largest number of refinements; None: limited by time                             |
    """

    screens: bool = True
    bends: int | None = None
    middle: Stage = MIDDLE
    fine: int = 2
    hurries: bool = False
    refinements: int | None = None


@runtime_checkable
class SmoothCurve(Curve, Protocol):
    """A curve with control points that descents move."""

    @property
    def controls(self) -> Float[Array, "control column"]:
        """Control points."""
        ...

    @property
    def samples(self) -> Float[Array, "n nq"]:
        """Configurations on the curve, dense enough for collision checks."""
        ...

    def even(self, n: int) -> Float[Array, "n nq"]:
        """Return n configurations on the curve at evenly spaced parameters, including both ends."""
        ...

    def with_controls(self, n: int) -> Self:
        """Return the curve, or an approximation of it, with n control points."""
        ...


@runtime_checkable
class CurveKind(Protocol):
    """Type of the curve of a descent."""

    @property
    def rolling(self) -> _native.Rolling | None:
        """Model of a base that rolls along the curve; None for curves of joints."""
        ...

    def curve(self, controls: Float[Array, "control column"]) -> SmoothCurve:
        """Return the curve with these control points."""
        ...


@final
@dataclass(frozen=True)
class JointCurves:
    """Splines in configuration space, with independent joints."""

    rolling: None = None

    def curve(self, controls: Float[Array, "control nq"]) -> Spline:
        """See `CurveKind`."""
        return Spline(controls)


@final
@dataclass(frozen=True, eq=False)
class Start:
    """A path to descend from, and the lengths at both ends where the sphere model is too close to obstacles [rad].

    `curve` is set if the path consists of samples of a curve from an earlier descent.
    """

    path: Path
    tight_start: float = 0.0
    tight_end: float = 0.0
    curve: SmoothCurve | None = None
    arrival: int = 0
    """Index of the arrival; see `Endpoints`."""
    kind: CurveKind = JointCurves()


@final
@dataclass(frozen=True, eq=False)
class DescentResult:
    """A free curve, its value (J plus the cost of its duration) by the descent, and the start of the descent."""

    curve: SmoothCurve
    value: float
    start: Start


@final
@dataclass
class DescentCount:
    """Number of descents that have ended."""

    descents: int = 0


@final
@dataclass(frozen=True, eq=False)
class MotionDescents:
    """Descends from paths.

    Args:
        space: Cost and clearance of states, with gradients.
        velocity: Velocity limits of the joints [rad/s or m/s].
        acceleration: Acceleration limits of the joints [rad/s^2 or m/s^2].
        is_free: Test whether a curve from a start is free of collision.
        has_clearance: Test whether a curve keeps the desired clearance; None if the required one is enough.
        settings: Amount of work in a round.
        felt: Limits on the acceleration that a carried object experiences.
        counts_points: Whether the impact is summed over samples of the motion (exposure "waypoints").
        projected: Projects configurations onto the constraints; None without constraints.
        time_price: Cost per second of motion in addition to J [rad/s].
        spacing: Largest length of the path per control point [rad or m]; None: unlimited.
        effort: Counter of descents over all rounds.
        leaving: Velocity at the start, which curves keep [rad/s]; None: at rest.
        least_leg: Least distance of the second control point from a moving start [rad].
        arriving: Velocity at the end, which curves keep [rad/s]; None: at rest.
        least_last_leg: Least distance of the last but one control point from a moving end [rad].
    """

    space: _native.Space
    velocity: Float[Array, " nq"]
    acceleration: Float[Array, " nq"]
    is_free: Callable[[SmoothCurve, Start], bool]
    has_clearance: Callable[[SmoothCurve, Start], bool] | None = None
    settings: DescentSettings = DescentSettings()
    felt: Sequence[_native.SpecificForceLimit] = ()
    counts_points: bool = False
    projected: Callable[[Float[Array, "n nq"]], Float[Array, "n nq"]] | None = None
    time_price: float = TIME_PRICE
    spacing: float | None = None
    effort: DescentCount = field(default_factory=DescentCount)
    leaving: Float[Array, " nq"] | None = None
    least_leg: float = 0.0
    arriving: Float[Array, " nq"] | None = None
    least_last_leg: float = 0.0

    def controls(self, start: Start, stage: Stage) -> int:
        """Return the number of control points: that of the stage, or more for a long path."""
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
            leaving=self.leaving,
            least_leg=self.least_leg,
            arriving=self.arriving,
            least_last_leg=self.least_last_leg,
        )
        _go_on(descent, stage.evaluations, budget)
        return descent

    def first(self, start: Start, budget: Budget) -> DescentResult | None:
        """Descend coarsely from one path; return None if the curve is not free at the end, or half-way."""
        half = COARSE.evaluations // 2
        descent = self.descended(start, replace(COARSE, evaluations=half), budget)
        if descent is None or not self.is_free(start.kind.curve(descent.controls), start):
            return None
        _go_on(descent, COARSE.evaluations - half, budget)
        curve = start.kind.curve(descent.controls)
        return DescentResult(curve, descent.value, start) if self.is_free(curve, start) else None

    def finished(self, start: Start, stage: Stage, budget: Budget) -> DescentResult | None:
        """Descend, with a heavier penalty while the curve is too close to obstacles; return None if it stays too close.

        The penalty also becomes heavier while the curve leads into a moving entity, or does not allow the speed at an
        end, but such a curve is returned if it is free otherwise.
        """
        descent = self.descended(start, stage, budget)
        if descent is None:
            return None
        for hardening in range(_HARDENINGS + 1):
            curve = start.kind.curve(descent.controls)
            enough = self.has_clearance is None or hardening >= _FOR_CLEARANCE or self.has_clearance(curve, start)
            passes = hardening == _HARDENINGS or (descent.gap > 0.0 and descent.speed_room >= 1.0)
            if enough and passes and self.is_free(curve, start):
                return DescentResult(curve, descent.value, start)
            if hardening < _HARDENINGS:
                descent.harden()
                _go_on(descent, _MORE, budget)
        return None


def _go_on(descent: _native.MotionDescent, evaluations: int, budget: Budget) -> None:
    """Continue a descent for up to `evaluations` evaluations, within the budget."""
    done = 0
    while done < evaluations and not budget.over:
        if descent.run(_SLICE, budget.remaining_seconds) < _SLICE:
            return
        done += _SLICE

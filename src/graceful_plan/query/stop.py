"""The quickest stop along a motion that keeps contents, grasp and limits.

The path is that of the motion, with time as its parameter, so that the present path speed is 1 and a stop never goes
faster. For a place to stop at, time-optimal timing (`timing.topp`) gives the largest path speed now from which the
robot can still stop there. The quickest stop is at the nearest place for which that is the present speed; it is found
by interpolation in a bracket. A liquid that already swings may spill in it. Further candidates therefore use less of
the brim tilt, or let the path speed fade out like a cosine, over longer and longer times.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import final

import numpy as np

from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import RetimingError, SettingError
from graceful_plan.judge.exact import exactly_free
from graceful_plan.judge.rule_checks import rule_checks
from graceful_plan.judge.verification import LIMIT_TOLERANCE, verify
from graceful_plan.result import PlanResult, PlanStatus, Verdict
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.setting_checks import finite
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.retiming import slowdown, slowed
from graceful_plan.timing.topp import SpecificForceLevels, fastest
from graceful_plan.timing.trajectory import Trajectory

_POINTS = 80
"""Grid points of a stop."""
_FIRST = 0.01
"""Least first guess of the time along the motion within which the robot stops [s]."""
_CLOSE = 1e-3
"""Relative excess of the path speed at which the search ends; the stop is slowed down by it."""
_SLACK = 1.01
"""Stops are timed from this path speed, within limits that are as much higher, and then slowed down to a path speed of
1: where the motion is at a limit itself, there would be no room for rounding otherwise."""
_FASTEST = 1.05
"""Largest path speed of the timing; a stop only becomes slower."""
_BEYOND, _LEAST, _MOST = 1.05, 1.3, 4.0
"""Excess of a guess of the place of the stop over an extrapolation; least and largest ratio to the last guess."""
_MOST_TRIALS = 30
_LEAST_SHARE = 0.05
"""Least share of the bracket by which a trial narrows it."""
_MOMENTS = 12
"""Moments at which a motion is checked before its verdict."""
_APART = 1e-9
"""Least time between two grid points [s], above the rounding of times."""
_UNLIMITED = 1e6
"""Velocity limit of the timing [rad/s or m/s]: the path speed is limited instead."""
_FADES = (0.1, 0.15, 0.2, 0.3, 0.4)
"""Shares of the rest of the motion along which path speeds fade out; a fade takes twice as long as its stretch."""


def plan_stop(
    motion: Trajectory, scene: Scene, *, at: float, constraints: Iterable[Constraint] | None = None
) -> PlanResult:
    """Plan the quickest stop along a motion that keeps the constraints.

    The stop follows the path of the motion and begins with its position and velocity. It may use the full limits of the
    robot, whatever speed the motion was planned with.

    Args:
        motion: The motion that the robot executes; contents swing by its part before `at`.
        scene: Robot, surroundings and carried object.
        at: Time at which the stop begins, on the clock of the motion [s].
        constraints: Constraints along the stop; by default those of `plan`: contents stay in, the grasp holds. With
            `[]`, it is the quickest stop within the limits of the robot.

    Returns:
        The result. Its trajectory begins at `at` and ends at rest. It is SOLVED if the stop has passed the judge. If no
        quicker stop does, the rest of the motion itself is the stop, which `detail` says. INFEASIBLE if that does not
        pass either, such as in a scene that has changed since.

    Raises:
        SettingError: If `at` is not a finite time, or motion or scene have another type.
    """
    started = time.perf_counter()
    if not isinstance(motion, Trajectory):
        raise SettingError("motion", motion, "a Trajectory")
    checked_scene(scene)
    finite("at", at, "a finite time [s]")
    asked = tuple(default_constraints(scene) if constraints is None else constraints)
    found, detail = quickest_stop(motion, scene, float(at), asked), ""
    if found is None:
        rest = motion.since(float(at))
        found = rest, _verdict(rest, motion, SceneConstraints(scene, asked).around(motion.q[[0, -1]]))
        detail = "no quicker stop than the motion's own end" if at < motion.t[-1] else ""
    stop, verdict = found
    if not verdict.passed:
        detail = "; ".join(f"{name}: {verdict.checks[name].detail}" for name in verdict.failures)
        return PlanResult(status=PlanStatus.INFEASIBLE, verdict=verdict, detail=detail)
    return PlanResult(
        status=PlanStatus.SOLVED,
        path=stop.path,
        trajectory=stop,
        verdict=verdict,
        detail=detail,
        stats={"total_time": time.perf_counter() - started},
    )


def quickest_stop(
    motion: Trajectory,
    scene: Scene,
    at: float,
    constraints: tuple[Constraint, ...],
) -> tuple[Trajectory, Verdict] | None:
    """Return the quickest stop along a motion that the judge passes; None if none is quicker than the motion itself.

    A stop with the largest specific force comes first. If it spills, fades are tried from the shortest on, until one
    passes or goes too far; then bisection finds the least reduction of the specific force with which a stop passes.

    Args:
        motion: The motion that the robot executes.
        scene: Robot, surroundings and carried object.
        at: Time at which the stop begins [s].
        constraints: Constraints along the stop.
    """
    if not (at < motion.t[-1] and len(motion) > 1):
        return None
    held = SceneConstraints(scene, constraints).around(motion.q[[0, -1]])
    left = float(motion.t[-1]) - at
    trials = _StopTrials(motion, at, held, left)
    first, *gentler = held.steady_levels
    stop, near = _quickest(motion, at, held, first, 0.0)
    if trials.tries(stop) is _Outcome.TOO_QUICK:
        for share in _FADES if held.felt else ():
            if trials.tries(_faded(motion, at, share * left)) is not _Outcome.TOO_QUICK:
                break
        low, high = 0, len(gentler)
        while low < high:
            middle = (low + high) // 2
            stop, _ = _quickest(motion, at, held, gentler[middle], near)
            too_quick = trials.tries(stop) is _Outcome.TOO_QUICK
            low, high = (middle + 1, high) if too_quick else (low, middle)
    return trials.best


@final
class _Outcome(Enum):
    """Outcome of a trial: why the stop was refused, or that it passed."""

    TOO_QUICK, TOO_LONG, PASSED = range(3)


@final
@dataclass
class _StopTrials:
    """Trials of stops, and the quickest one that has passed the judge."""

    motion: Trajectory
    at: float
    held: SceneConstraints
    longest: float
    """Time that a stop has to undercut [s]."""
    best: tuple[Trajectory, Verdict] | None = None

    def tries(self, stop: Trajectory | None) -> _Outcome:
        """Verify a stop, unless it takes too long or one of the quicker checks refuses it; keep it if it passes."""
        scene = self.held.scene
        if stop is None or stop.duration >= self.longest or surely_collides(stop, scene):
            return _Outcome.TOO_LONG
        if slowdown(stop, scene.limits) > 1.0 + LIMIT_TOLERANCE:
            return _Outcome.TOO_QUICK
        rules = [constraint.rule(scene) for constraint in self.held.constraints]
        if not all(check.passed for check in rule_checks(stop, scene, rules, self.motion).values()):
            return _Outcome.TOO_QUICK
        verdict = _verdict(stop, self.motion, self.held)
        if not verdict.passed:
            return _Outcome.TOO_LONG if "collision" in verdict.failures else _Outcome.TOO_QUICK
        self.best, self.longest = (stop, verdict), stop.duration
        return _Outcome.PASSED


def _verdict(stop: Trajectory, motion: Trajectory, held: SceneConstraints) -> Verdict:
    scene, begun = held.scene, motion.at(float(stop.t[0]))
    proof = compile_scene(scene).proof.clearance
    return verify(stop, scene, start=begun, constraints=held.constraints, clearance=proof, before=motion)


def surely_collides(motion: Trajectory, scene: Scene) -> bool:
    """Return whether a motion collides at one of a few moments, which takes less time than a verdict."""
    return not bool(exactly_free(motion.positions(np.linspace(motion.t[0], motion.t[-1], _MOMENTS)), scene).all())


def _quickest(
    motion: Trajectory,
    at: float,
    held: SceneConstraints,
    level: SpecificForceLevels | None,
    near: float,
) -> tuple[Trajectory | None, float]:
    """Return the quickest stop within the limits of one level, which is not verified.

    Args:
        motion: The motion.
        at: Time at which the stop begins [s].
        held: Constraints and scene.
        level: Limits on the specific force; None for none.
        near: Guess of the time that the motion takes to the place of the stop [s].

    Returns:
        The stop, None if it takes as long as the motion; and the time that the motion takes to its place [s].
    """
    velocity = motion.at(at).qd
    speed = float(np.linalg.norm(velocity))
    left = float(motion.t[-1]) - at
    if speed < 1e-9:
        still = motion.at(np.array([at]))
        return Trajectory(np.array([at]), still.q, 0.0 * still.qd, 0.0 * still.qdd, motion.joints), 0.0
    # On a straight line, a robot that brakes comes half as far as it would without braking.
    straight = 0.5 * float((np.abs(velocity) / held.scene.limits.acceleration).max())

    def ending(after: float) -> tuple[Trajectory | None, float]:
        stop = _timed(motion, at, after, held, level)
        return stop, 0.0 if stop is None else float(np.linalg.norm(stop.qd[0])) / speed

    # The square of the speed is about proportional to the way on which it can be lost.
    short, long, aim = 0.0, max(_FIRST, straight, near), _SLACK + 0.5 * _CLOSE
    lacking = exceeding = aim**2
    while (found := ending(min(long, left)))[1] < _SLACK:
        if long >= left:
            return None, left
        lacking = aim**2 - found[1] ** 2
        short, long = long, long * float(np.clip(_BEYOND * aim**2 / max(found[1], _FIRST) ** 2, _LEAST, _MOST))
    long, exceeding, below = min(long, left), found[1] ** 2 - aim**2, None
    for _ in range(_MOST_TRIALS):
        if found[1] < _SLACK + _CLOSE:
            break
        share = lacking / (lacking + exceeding)
        middle = short + float(np.clip(share, _LEAST_SHARE, 1.0 - _LEAST_SHARE)) * (long - short)
        trial = ending(middle)
        # An end that stays twice counts half, so that both ends approach (the Illinois method).
        again, below = below is (trial[1] < _SLACK), trial[1] < _SLACK
        if below:
            short, lacking, exceeding = middle, aim**2 - trial[1] ** 2, exceeding * (0.5 if again else 1.0)
        else:
            long, found, lacking, exceeding = middle, trial, lacking * (0.5 if again else 1.0), trial[1] ** 2 - aim**2
    stop, excess = found
    if stop is None or excess > _SLACK + 10.0 * _CLOSE:
        return None, long
    return slowed(stop, excess).later(at), long


def _timed(
    motion: Trajectory, at: float, after: float, held: SceneConstraints, level: SpecificForceLevels | None
) -> Trajectory | None:
    """Return the fastest motion from `at` to rest where the motion is `after` seconds later; None if there is none."""
    grid, restraint = _grid(motion, at, after), held.restraint()
    slower = np.tile([0.0, 1.0, _FASTEST**2], (len(grid.s) - 1, 1, 1))
    limit = slower if restraint is None else np.concatenate([slower, restraint(grid)], axis=1)
    unlimited = np.full(len(motion.joints), _UNLIMITED)
    try:
        found = fastest(
            grid, unlimited, _SLACK**2 * held.scene.limits.acceleration, limit=np.ascontiguousarray(limit), felt=level
        )
    except RetimingError:
        return None
    return Trajectory(found.t, found.q, found.qd, found.qdd, motion.joints)


def _grid(motion: Trajectory, at: float, after: float) -> CurveGrid:
    """Return points along a motion, its samples among them, since its acceleration may jump there."""
    even = np.linspace(at, at + after, _POINTS)
    inside = motion.t[(motion.t > at + _APART) & (motion.t < at + after - _APART)]
    t = np.union1d(even, inside)
    t = t[np.append(True, np.diff(t) > 1e-3 * after / _POINTS) | np.isin(t, inside)]
    t = np.append(t[(t > at) & (t < at + after)], at + after)
    t = np.append(at, t)
    piece = np.clip(np.searchsorted(motion.t, 0.5 * (t[1:] + t[:-1]), side="right") - 1, 0, len(motion) - 2)
    first, last = motion.piece_accelerations
    share = (np.stack([t[:-1], t[1:]]) - motion.t[piece]) / np.diff(motion.t)[piece]
    bend = first[piece] + share[:, :, None] * (last - first)[piece]
    state = motion.at(t)
    ends = np.zeros(len(t), dtype=bool)
    ends[-1] = True
    return CurveGrid(t - at, state.q, np.stack([state.qd[:-1], state.qd[1:]], axis=1), np.moveaxis(bend, 0, 1), ends)


def _faded(motion: Trajectory, at: float, after: float) -> Trajectory:
    """Return the stop whose path speed fades from 1 to 0 like a cosine, to where the motion is `after` seconds later.

    It may exceed the limits.
    """
    seconds = 2.0 * after
    t = np.linspace(0.0, seconds, _POINTS)
    phase = np.pi * t / seconds
    s = 0.5 * (t + seconds / np.pi * np.sin(phase))
    speed, acceleration = 0.5 * (1.0 + np.cos(phase))[:, None], -0.5 * np.pi / seconds * np.sin(phase)[:, None]
    state = motion.at(at + s)
    qdd = state.qdd * speed**2 + state.qd * acceleration
    return Trajectory(at + t, state.q, state.qd * speed, qdd, motion.joints)

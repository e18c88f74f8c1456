"""Optimise path and timing of a trajectory together, within all limits, by direct transcription and IPOPT.

The cost is time or effort, plus the impact of a failure integrated over time. The variables are the duration and the
positions and velocities at evenly spaced nodes (`spline_program`). Limits, torque and clearance are constraints at
nodes and between them; the independent judge checks the result densely. This is a local method: it improves the
initial motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import Cost
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError
from graceful_plan.judge.verification import verify
from graceful_plan.path import Path, finite_array, is_whole
from graceful_plan.planners.optimisers.nlp import SolveOutcome, Values, minimise
from graceful_plan.planners.planner import Budget
from graceful_plan.result import Verdict
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import finite, not_negative, positive_or_none
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.transcription.motion_check import Violation, violations, within_limits
from graceful_plan.transcription.motion_program import OBJECTIVES, MotionTask, motion_cost, motion_program
from graceful_plan.transcription.spline_program import SplineProgram
from graceful_plan.transcription.symbolic import symbolic_robot

_KEPT = 3
"""Number of best iterates kept for the judge."""
_PATIENCE, _LEAST_GAIN = 30, 1e-3
"""A solve ends after this many iterations without this relative gain, since IPOPT stalls at kinks of the clearance."""
_STRETCH = 1.5
"""Largest duration relative to the initial one if time is not the objective."""
_ATTEMPTS = 3
"""Largest number of solves; each keeps more clearance than the last if the judge found a collision between samples."""
_RESERVE = 0.2
"""Time reserved for the judge [s], at most a third of the time limit."""
_REST = 1e-6
"""Largest speed of a joint that counts as at rest [rad/s or m/s]."""


class OptimisationStatus(Enum):
    """How an optimisation ended; the value is a sentence with a remedy."""

    SOLVED = "A local optimum within all limits."
    STOPPED = "A verified motion within all limits, perhaps not the best: budget or progress ended before an optimum."
    UNCHANGED = "Nothing better than the motion to begin with was found; it keeps all limits."
    INFEASIBLE = "No motion within all limits was found near the one given; relax what `violated` names, or allow time."


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class OptimisedTrajectory:
    """The outcome of `optimise_trajectory`."""

    status: OptimisationStatus
    trajectory: Trajectory | None = None
    """The best verified motion within all limits; None if there is none."""
    violated: tuple[Violation, ...] = ()
    """The limits that the last iterate violates, worst first, if there is no trajectory."""
    cost: float = np.inf
    """Cost of the trajectory; see `optimise_trajectory`."""
    initial_cost: float = np.inf
    """Cost of the initial motion; infinite if it violates a limit or collides."""
    verdict: Verdict = field(default_factory=Verdict)
    """The judge's verdict on the trajectory."""
    detail: str = ""
    stats: Mapping[str, float] = field(default_factory=dict)
    """Seconds, IPOPT iterations and solves."""


def optimise_trajectory(
    initial: Path | Trajectory,
    scene: Scene,
    objective: str = "time",
    *,
    w: float = 0.0,
    impact: Cost | None = None,
    duration: float | None = None,
    jerk: float | ArrayLike | None = None,
    torque: bool = True,
    margin: float = 0.002,
    intervals: int = 32,
    time_limit: float = 10.0,
    iterations: int = 300,
    cancelled: Callable[[], bool] | None = None,
) -> OptimisedTrajectory:
    """Optimise path and timing of a motion together, from rest to rest between the same ends.

    The cost is the objective plus w times the integral over time of the impact of a failure. Objectives: "time", the
    duration [s]; "effort", the integral of (torque / limit)^2 summed over joints; "acceleration", the same with
    accelerations; "length", the path length in joint space [rad].

    Args:
        initial: Initial guess; a path is timed first. It may violate limits and collide.
        scene: Robot, limits and surroundings. Moving entities are ignored.
        objective: "time", "effort", "acceleration" or "length".
        w: Safety weight, the cost per second of an impact of 1.
        impact: Impact model; the default `ImpactCost` if None.
        duration: Longest duration [s]. The default is no limit for "time", else 1.5 times the initial duration.
        jerk: Limit of the jerk, one for all joints or one per joint [rad/s^3]; none by default. With it, accelerations
            are continuous.
        torque: Whether to enforce the scene's torque limits, with the carried object as load.
        margin: Clearance to keep [m]; near the ends, at most the clearance of the initial motion there.
        intervals: Number of cubic pieces, all of the same duration.
        time_limit: Time limit of the whole call [s].
        iterations: Largest number of IPOPT iterations per solve.
        cancelled: Called between iterations; the optimisation stops once it returns True.

    Returns:
        A result whose trajectory passed `verify`, or the violated limits if there is none.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, unknown objectives, settings outside their range.
    """
    seconds = _checked_seconds(time_limit)
    budget = Budget(seconds - min(_RESERVE, seconds / 3.0), cancelled=cancelled or (lambda: False))
    nq = len(scene.joints)
    if initial.q.shape[1] != nq:
        raise ShapeError("initial", initial.q.shape, f"(n, {nq})")
    if objective not in OBJECTIVES:
        raise UnknownNameError("objective", objective, OBJECTIVES)
    _check(w=w, duration=duration, margin=margin, intervals=intervals, iterations=iterations)
    still = scene.without_moving() if scene.moving else scene
    limited = torque and bool(np.isfinite(scene.limits.torque).any())
    first = _timed(initial, scene)
    longest = np.inf if objective == "time" else _STRETCH * first.duration
    task = MotionTask(
        scene=still,
        objective=objective,
        w=float(w),
        impact=ImpactCost() if impact is None else impact,
        duration=longest if duration is None else float(duration),
        jerk=None if jerk is None else _checked_jerk(jerk, nq),
        robot=symbolic_robot(still) if limited or objective == "effort" else None,
        torque=limited,
        margin=float(margin),
        intervals=int(intervals),
    )
    return _Optimisation(task, first, budget, iterations).run()


@final
class _Optimisation:
    """State of one call: the initial motion, the solves, and the judge's verdicts on their results."""

    def __init__(self, task: MotionTask, first: Trajectory, budget: Budget, iterations: int) -> None:
        self.task, self.first, self.budget, self.iterations = task, first, budget, iterations
        self.spent, self.solves = 0, 0

    def run(self) -> OptimisedTrajectory:
        before = self._fate(self.first)
        best = None if before[1] else (self.first, before[0])
        initial_cost = motion_cost(self.task, self.first) if best else np.inf
        lost = self._hopeless() if len(self.first) > 1 else None
        if lost:
            return self._result(OptimisationStatus.INFEASIBLE, None, lost, np.inf, np.inf)
        if len(self.first) < 2:
            status = OptimisationStatus.SOLVED if best else OptimisationStatus.INFEASIBLE
            return self._result(status, best, before[1], initial_cost, initial_cost)
        found, outcome, broken = self._search()
        cost = motion_cost(self.task, found[0]) if found else np.inf
        if found and cost < initial_cost:
            status = OptimisationStatus.SOLVED if outcome is SolveOutcome.SOLVED else OptimisationStatus.STOPPED
            return self._result(status, found, (), cost, initial_cost)
        status = OptimisationStatus.UNCHANGED if best else OptimisationStatus.INFEASIBLE
        return self._result(status, best, () if best else broken or before[1], initial_cost, initial_cost)

    def _result(
        self,
        status: OptimisationStatus,
        best: tuple[Trajectory, Verdict] | None,
        violated: tuple[Violation, ...],
        cost: float,
        initial_cost: float,
    ) -> OptimisedTrajectory:
        return OptimisedTrajectory(
            status=status,
            trajectory=best[0] if best else None,
            verdict=best[1] if best else Verdict(),
            violated=violated,
            cost=cost,
            initial_cost=initial_cost,
            detail="; ".join(str(violation) for violation in violated),
            stats={"seconds": self.budget.elapsed, "iterations": float(self.spent), "solves": float(self.solves)},
        )

    def _search(self) -> tuple[tuple[Trajectory, Verdict] | None, SolveOutcome, tuple[Violation, ...]]:
        """Solve, and repeat with more clearance as long as the judge finds a collision between samples."""
        outcome, broken, margin = SolveOutcome.FAILED, (), self.task.margin
        guess = self.first
        for _ in range(_ATTEMPTS):
            if self.budget.exhausted:
                break
            program, x = motion_program(self.task, guess, margin)
            solve = _Solve(program, self.budget)
            solution = minimise(
                program,
                x,
                solve.watch,
                iterations=self.iterations,
                tolerance=1e-4,
                settings={"mu_strategy": "adaptive"},
            )
            outcome, self.spent, self.solves = solution.outcome, self.spent + solution.iterations, self.solves + 1
            deepest = 0.0
            for x in (*(kept for _, kept in solve.kept), solution.x):
                motion = self._motion(program, x)
                verdict, broken = self._fate(motion)
                if not broken:
                    return (motion, verdict), outcome, ()
                if "collision" in verdict.failures:
                    deepest = max(deepest, -verdict.checks["collision"].worst)
            if not solve.kept or deepest == 0.0:
                break
            margin, guess = margin + 2.0 * deepest + 0.002, self._motion(program, solve.kept[0][1])
        return None, outcome, broken

    def _motion(self, program: SplineProgram, x: Float[Array, " variable"]) -> Trajectory:
        """Return the trajectory of an iterate, slowed down by the small amount that rounding needs."""
        layout, task = program.layout, self.task
        q, w = layout.nodes(x)
        h = layout.h(x)
        t = h * np.arange(len(q))
        plain = Trajectory(t, q, w / h, np.zeros_like(q), task.scene.joints)
        a0, a1 = plain.piece_accelerations
        timed = Trajectory(t, q, w / h, np.concatenate([a0, a1[-1:]]), task.scene.joints)
        return within_limits(timed, task.scene.limits, task.jerk, task.robot if task.torque else None)

    def _fate(self, motion: Trajectory) -> tuple[Verdict, tuple[Violation, ...]]:
        """Return the judge's verdict and the violated limits; collisions are checked only if no limit is violated."""
        task = self.task
        broken = violations(
            motion,
            task.scene.limits,
            jerk=task.jerk,
            robot=task.robot if task.torque else None,
            duration=task.duration,
        )
        if broken:
            return Verdict(), _worst_first(broken)
        verdict = verify(motion, task.scene, start=self.first.q[0], goal=self.first.q[-1])
        return verdict, tuple(
            Violation(
                limit="clearance" if name == "collision" else name,
                time=verdict.checks[name].first,
                value=verdict.checks[name].worst,
                bound=verdict.checks[name].limit,
            )
            for name in verdict.failures
        )

    def _hopeless(self) -> tuple[Violation, ...]:
        """Return limits that no motion between these ends can meet: positions of the ends, or time for the distance."""
        task, limits = self.task, self.task.scene.limits
        ends = Trajectory(
            self.first.t[[0, -1]], self.first.q[[0, -1]], np.zeros((2, len(task.scene.joints))),
            np.zeros((2, len(task.scene.joints))), task.scene.joints,
        )  # fmt: skip
        beyond = violations(ends, limits)
        if any(violation.limit == "position" for violation in beyond):
            return tuple(violation for violation in beyond if violation.limit == "position")
        way = np.abs(self.first.q[-1] - self.first.q[0])
        cruise = way > limits.velocity**2 / limits.acceleration
        least = np.where(cruise, way / limits.velocity + limits.velocity / limits.acceleration, 0.0)
        least = np.where(cruise, least, 2.0 * np.sqrt(way / limits.acceleration))
        slowest = int(np.argmax(least))
        if least[slowest] <= task.duration:
            return ()
        T, name = task.duration, task.scene.joints[slowest]
        if limits.velocity[slowest] * T <= way[slowest]:
            return (
                Violation(limit="velocity", joint=name, value=float(way[slowest] / T), bound=limits.velocity[slowest]),
            )
        need = 4.0 * way[slowest] / T**2
        return (Violation(limit="acceleration", joint=name, value=float(need), bound=limits.acceleration[slowest]),)


@final
class _Solve:
    """Watches one solve: keeps the best feasible iterates and ends it on timeout or lack of progress."""

    def __init__(self, program: SplineProgram, budget: Budget) -> None:
        self.program, self.budget = program, budget
        self.kept: list[tuple[float, Array]] = []
        self._idle = 0

    def watch(self, x: Float[Array, " variable"], values: Values) -> bool:
        if self.budget.exhausted:
            return True
        self._idle += 1
        excess = np.maximum(self.program.least - values.constraints, values.constraints - self.program.most)
        best = self.kept[0][0] if self.kept else np.inf
        if values.cost < best and np.all(excess <= self.program.slack):
            if values.cost < best - _LEAST_GAIN * abs(best) or not self.kept:
                self._idle = 0
            self.kept = [(values.cost, x.copy()), *self.kept][:_KEPT]
        return bool(self.kept) and self._idle > _PATIENCE


def _worst_first(broken: tuple[Violation, ...]) -> tuple[Violation, ...]:
    def excess(violation: Violation) -> float:
        return abs(violation.value - violation.bound) / max(abs(violation.bound), 1e-9)

    return tuple(sorted(broken, key=excess, reverse=True))


def _timed(initial: Path | Trajectory, scene: Scene) -> Trajectory:
    if isinstance(initial, Path):
        return retime(initial, scene.limits, scene.joints)
    if np.any(np.abs(initial.qd[[0, -1]]) > _REST):
        raise SettingError("initial.qd", initial.qd[[0, -1]].tolist(), "rest at both ends")
    return Trajectory(initial.t - initial.t[0], initial.q, initial.qd, initial.qdd, scene.joints)


def _checked_seconds(time_limit: float) -> float:
    if not time_limit >= 0.0:
        raise SettingError("time_limit", time_limit, "a number of seconds, at least 0")
    return float(time_limit)


def _checked_jerk(jerk: float | ArrayLike, nq: int) -> Float[Array, " nq"]:
    value = finite_array("jerk", np.asarray(jerk))
    if value.shape not in ((), (nq,)):
        raise ShapeError("jerk", value.shape, f"() or ({nq},)")
    if not np.all(value > 0.0):
        raise SettingError("jerk", jerk, "numbers > 0 [rad/s^3]")
    return np.broadcast_to(value, (nq,)).copy()


def _check(*, w: float, duration: float | None, margin: float, intervals: int, iterations: int) -> None:
    not_negative("w", w)
    positive_or_none("duration", duration, "a finite time > 0 s")
    finite("margin", margin, "a finite distance [m]")
    for name, value, least in (("intervals", intervals, 2), ("iterations", iterations, 0)):
        if not is_whole(value) or value < least:
            raise SettingError(name, value, f"an integer >= {least}")

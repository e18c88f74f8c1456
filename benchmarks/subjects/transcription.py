"""Path and timing at once: direct transcription against TOPP-RA on the same path, and what failures do along both."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import failbench
import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.timing.retiming import slowed
from graceful_plan.transcription.symbolic import SymbolicRobot, symbolic_robot
from graceful_plan.transcription.trajectory_optimisation import OptimisationStatus, OptimisedTrajectory

Array = np.ndarray

TITLE = "Direct transcription: trajectories optimised as a whole, against TOPP-RA on the same path"
MEASURED = """\
Paths of each task, planned with w = 1 (anytime planner, {iterations} iterations) and timed by TOPP-RA at the limits of
velocity and acceleration, corners cut as far as that stays free: that is what `gp.optimise_trajectory` begins with.
Then, each within {seconds:g} s, with the torque limits too: least time; least time with jerk below {jerk:g} rad/s^3;
least effort in {longer:g} times the time; and least F = T + w times the predicted impact over time at w = 1. Brackets:
seconds that it took; (-) nothing better was found. Torque: greatest share of a torque limit, before and after the least
time. Every trajectory was passed by `gp.verify`, or it counts as none.

Observed: {fault} along the motion by TOPP-RA and along that of least F, {n} rollouts each with
common random numbers, the onset uniform over the duration; mean impact of a failure times the duration, which is what a
constant rate of failures adds up to for one executed motion. Both are played at the same pace, the highest of {speeds}
at which the simulated robot keeps up with both and its grasp holds. Motions for which there is none are refused.
"""
JERK = 5000.0
LONGER = 1.5
SECONDS = 10.0
FAULT = "drop/gripper_failure/critical"
SPEEDS = (1.0, 0.7, 0.5)
W = 1.0
"""Safety weight of the plans and of F."""
_MOMENTS = 800
"""Moments of a trajectory at which its impact is sampled."""


@dataclass(frozen=True, kw_only=True)
class ObservedHarm:
    """What failures do along the motion by TOPP-RA and along that of least F, in this order."""

    refused: str = ""
    """Why nothing was observed, if so."""
    speed: float = math.nan
    """Share of the velocity limits that both may use."""
    impact: tuple[float, float] = (math.nan, math.nan)
    """Mean of a failure."""
    duration: tuple[float, float] = (math.nan, math.nan)
    """[s]"""

    @property
    def harm(self) -> tuple[float, float]:
        """Impact times duration [s]."""
        return self.impact[0] * self.duration[0], self.impact[1] * self.duration[1]


@dataclass(frozen=True, kw_only=True)
class Transcribed:
    """A task: what its motion began as, and what became of it."""

    task: str
    refused: str = ""
    before: float = math.nan
    """Duration by TOPP-RA [s]."""
    torque: tuple[float, float] = (math.nan, math.nan)
    plain: float = math.nan
    """F of the motion to begin with [s]."""
    found: dict[str, OptimisedTrajectory] = field(default_factory=dict)
    observed: ObservedHarm = ObservedHarm()


def run(options: suite.Options) -> str:
    """Optimise the motions of all tasks and return Markdown."""
    iterations, seconds, rollouts = options.pick((20_000, SECONDS, 100), quick=(500, 2.0, 20))
    seconds = options.seconds or seconds
    jobs = [(name, iterations, seconds, rollouts) for name in suite.task_names(options)]
    cases = sorted(suite.spread(measure, jobs, options.processes, "transcription"), key=lambda case: case.task)
    speeds = ", ".join(f"{speed:g}" for speed in SPEEDS)
    told = MEASURED.format(
        iterations=iterations, seconds=seconds, jerk=JERK, longer=LONGER, fault=FAULT, n=rollouts, speeds=speeds
    )
    return "\n".join([told, report.targets(_targets(cases)), report.table(_HEADER, _rows(cases))])


def measure(job: tuple[str, int, float, int]) -> Transcribed:
    """Plan and time a path, optimise what comes of it in four ways, and let the gripper fail."""
    name, iterations, seconds, rollouts = job
    task = suite.task(name)
    objective = gp.Objective(w=W)
    planned = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=iterations)
    if planned.trajectory is None or planned.path is None:
        return Transcribed(task=name, refused=planned.status.name)
    first, scene = planned.trajectory, task.scene
    states = objective.bind(scene).states
    wanted: dict[str, dict[str, Any]] = {
        "time": {},
        "jerk": {"jerk": JERK},
        "effort": {"objective": "effort", "duration": LONGER * first.duration},
        "F": {"w": W},
    }
    found = {
        key: gp.optimise_trajectory(first, scene, time_limit=seconds, iterations=1000, **settings)
        for key, settings in wanted.items()
    }
    robot, fastest = symbolic_robot(scene), found["time"].trajectory
    return Transcribed(
        task=name,
        before=first.duration,
        torque=(_load(first, robot, scene), math.nan if fastest is None else _load(fastest, robot, scene)),
        plain=timed_cost(first, states),
        found=found,
        observed=observed(task, first, found["F"].trajectory, rollouts),
    )


def timed_cost(motion: gp.Trajectory, impact: Callable[[Array, Array], Array]) -> float:
    """Return F = T + w times the impact over time [s], by the midpoint rule."""
    share = (np.arange(_MOMENTS) + 0.5) / _MOMENTS
    state = motion.at(motion.t[0] + share * motion.duration)
    return motion.duration * (1.0 + W * float(impact(state.q, state.qd).mean()))


def observed(task: gp.Task, first: gp.Trajectory, least: gp.Trajectory | None, rollouts: int) -> ObservedHarm:
    """Let the gripper fail along two motions, as fast as the healthy robot keeps up with both."""
    if task.object_name is None:
        return ObservedHarm(refused="nothing is carried")
    if least is None:
        return ObservedHarm(refused="no motion of least F")
    refused = ""
    for speed in SPEEDS:
        motions = [slowed(motion, 1.0 / speed) for motion in (first, least)]
        try:
            reports = [failbench.validate(motion, task.scene, FAULT, n=rollouts, threads=1) for motion in motions]
        except failbench.ExecutionRefused as error:
            refused = f"{error.what} at {speed:g}"
            continue
        return ObservedHarm(
            speed=speed,
            impact=(reports[0].observed.mean, reports[1].observed.mean),
            duration=(motions[0].duration, motions[1].duration),
        )
    return ObservedHarm(refused=refused)


def _load(motion: gp.Trajectory, robot: SymbolicRobot, scene: gp.Scene) -> float:
    """Greatest share of a torque limit."""
    state = motion.at(np.linspace(motion.t[0], motion.t[-1], 500))
    return float(np.abs(robot.torques(*state) / scene.limits.torque).max())


_HEADER = (
    "task",
    "TOPP-RA [s]",
    "least time [s]",
    "jerk [s]",
    "effort",
    "F plain [s]",
    "F [s]",
    "torque",
    "pace",
    "observed, TOPP-RA",
    "observed, F",
    "ratio",
)


def _targets(cases: Sequence[Transcribed]) -> Iterator[report.Target]:
    done = [case for case in cases if not case.refused]
    found = [(case, result) for case in done for result in case.found.values()]
    none = [f"{case.task} ({result.detail})" for case, result in found if result.trajectory is None]
    yield report.Target(
        what="optimisations that end with a verified trajectory within all limits",
        wanted="all",
        measured=f"{len(found) - len(none)} of {len(found)} {', '.join(none)}",
        met=not none if found else None,
    )
    yield _ratio("least time over TOPP-RA's on the path to begin with", done, "time", lambda case: case.before)
    yield _ratio("F over that of TOPP-RA's on the path to begin with", done, "F", lambda case: case.plain)
    yield _harm_target(done)
    yield report.Target(
        what="seconds of an optimisation, median and worst",
        wanted="told",
        measured=f"{_median(r.stats['seconds'] for _, r in found):.2f}, "
        f"{max((r.stats['seconds'] for _, r in found), default=math.nan):.2f}",
        met=None if not found else True,
    )


def _harm_target(cases: Sequence[Transcribed]) -> report.Target:
    seen = [case.observed.harm for case in cases if not case.observed.refused]
    before, after = (math.fsum(column) for column in zip(*seen, strict=True)) if seen else (math.nan, math.nan)
    ratio = _median(after / before for before, after in seen if before > 0.0)
    refused = [f"{case.task}: {case.observed.refused}" for case in cases if case.observed.refused]
    return report.Target(
        what="observed harm per executed motion (impact x duration), sum and median ratio",
        wanted="less than TOPP-RA's, both",
        measured=f"{before:.2f} to {after:.2f} s, median ratio {ratio:.3f}, {len(seen)} of {len(cases)} tasks"
        + (f"; refused: {', '.join(refused)}" if refused else ""),
        met=after < before and ratio < 1.0 if seen else None,
    )


def _ratio(what: str, cases: Sequence[Transcribed], key: str, base: Callable[[Transcribed], float]) -> report.Target:
    shares = [case.found[key].cost / base(case) for case in cases if math.isfinite(case.found[key].cost)]
    measured = f"median {_median(shares):.3f}, at most {max(shares, default=math.nan):.3f}"
    return report.Target(
        what=what, wanted="median < 1", measured=measured, met=_median(shares) < 1.0 if shares else None
    )


def _rows(cases: Sequence[Transcribed]) -> Iterator[Sequence[object]]:
    for case in cases:
        if case.refused:
            yield (case.task, f"refused: {case.refused}", *[""] * (len(_HEADER) - 2))
            continue
        yield (
            case.task,
            f"{case.before:.3f}",
            _told(case.found["time"]),
            _told(case.found["jerk"]),
            _told(case.found["effort"], before=True),
            f"{case.plain:.2f}",
            _told(case.found["F"]),
            " to ".join(report.percent(load, 0) for load in case.torque),
            *_harm_cells(case.observed),
        )


def _harm_cells(found: ObservedHarm) -> Sequence[str]:
    if found.refused:
        return (f"refused: {found.refused}", "", "", "")
    before, after = found.harm
    both = zip(found.impact, found.duration, strict=True)
    each = (f"{impact:.3f} x {duration:.2f} s" for impact, duration in both)
    return (f"{found.speed:g}", *each, f"{after / before:.2f}" if before > 0.0 else "none")


def _told(result: OptimisedTrajectory, before: bool = False) -> str:
    if result.trajectory is None:
        return f"none: {result.detail}"
    same = " (-)" if result.status is OptimisationStatus.UNCHANGED else ""
    begun = f"{result.initial_cost:.3f} to " if before else ""
    return f"{begun}{result.cost:.3f}{same} ({result.stats['seconds']:.1f})"


def _median(values: object) -> float:
    found = list(values)  # type: ignore[call-overload]
    return float(np.median(found)) if found else math.nan

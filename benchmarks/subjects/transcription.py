"""Path and timing at once: trajectories by direct transcription against the timing of the path they begin with."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.transcription.symbolic import SymbolicRobot, symbolic_robot

TITLE = "Direct transcription: trajectories optimised as a whole, against TOPP-RA on the same path"
MEASURED = """\
Paths of each task, planned with w = 1 (anytime planner, {iterations} iterations) and timed by TOPP-RA at the limits of
velocity and acceleration, corners cut as far as that stays free: that is what `gp.optimise_trajectory` begins with.
Then, each within {seconds:g} s, with the torque limits too: least time; least time with jerk below {jerk:g} rad/s^3;
least effort in {longer:g} times the time; and least F = T + w times the impact over time at w = 1, against that of
the plain timing. Brackets: seconds that it took; (-) nothing better was found.
Torque: greatest share of a torque limit, before and after the least time. Every trajectory was passed by `gp.verify`,
or it counts as none.
"""
JERK = 5000.0
LONGER = 1.5
SECONDS = 10.0
MOMENTS = 800
"""Of a trajectory, at which its impact is sampled."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A task: what its motion began as, and what became of it."""

    task: str
    refused: str = ""
    before: float = math.nan
    """Duration by TOPP-RA [s]."""
    torque: tuple[float, float] = (math.nan, math.nan)
    plain: float = math.nan
    """F of the plain timing [s]."""
    found: dict[str, gp.OptimisedTrajectory] = field(default_factory=dict)


def run(options: suite.Options) -> str:
    """Optimise the motions of all tasks and return Markdown."""
    iterations, seconds = (500, 2.0) if options.quick else (20_000, options.seconds or SECONDS)
    jobs = [(name, iterations, seconds) for name in suite.task_names(options)]
    cases = sorted(suite.spread(measure, jobs, options.processes, "transcription"), key=lambda case: case.task)
    told = MEASURED.format(iterations=iterations, seconds=seconds, jerk=JERK, longer=LONGER)
    return "\n".join([told, report.targets(_targets(cases)), report.table(_HEADER, _rows(cases))])


def measure(job: tuple[str, int, float]) -> Case:
    """Plan and time a path, and optimise what comes of it in four ways."""
    name, iterations, seconds = job
    task = suite.task(name)
    objective = gp.Objective(w=1.0)
    planned = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=iterations)
    if planned.trajectory is None or planned.path is None:
        return Case(task=name, refused=planned.status.name)
    first, scene = planned.trajectory, task.scene
    states = objective.bind(scene).states
    wanted: dict[str, dict[str, Any]] = {
        "time": {},
        "jerk": {"jerk": JERK},
        "effort": {"objective": "effort", "duration": LONGER * first.duration},
        "F": {"w": 1.0},
    }
    found = {
        key: gp.optimise_trajectory(first, scene, time_limit=seconds, iterations=1000, **settings)
        for key, settings in wanted.items()
    }
    robot, fastest = symbolic_robot(scene), found["time"].trajectory
    return Case(
        task=name,
        before=first.duration,
        torque=(_load(first, robot, scene), math.nan if fastest is None else _load(fastest, robot, scene)),
        plain=timed_cost(first, states),
        found=found,
    )


def timed_cost(trajectory: gp.Trajectory, impact: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> float:
    """Return F of a trajectory at w = 1 [s], by the midpoint rule in time."""
    state = trajectory.at(trajectory.t[0] + (np.arange(MOMENTS) + 0.5) / MOMENTS * trajectory.duration)
    return trajectory.duration * (1.0 + float(impact(state.q, state.qd).mean()))


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
)


def _targets(cases: Sequence[Case]) -> Iterator[report.Target]:
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
    yield _ratio("F over that of TOPP-RA on the path to begin with", done, "F", lambda case: case.plain)
    yield report.Target(
        what="seconds of an optimisation, median and worst",
        wanted="told",
        measured=f"{_median(r.stats['seconds'] for _, r in found):.2f}, "
        f"{max((r.stats['seconds'] for _, r in found), default=math.nan):.2f}",
        met=None if not found else True,
    )


def _ratio(what: str, cases: Sequence[Case], key: str, base: Callable[[Case], float]) -> report.Target:
    shares = [case.found[key].cost / base(case) for case in cases if math.isfinite(case.found[key].cost)]
    measured = f"median {_median(shares):.3f}, at most {max(shares, default=math.nan):.3f}"
    return report.Target(
        what=what, wanted="median < 1", measured=measured, met=_median(shares) < 1.0 if shares else None
    )


def _rows(cases: Sequence[Case]) -> Iterator[Sequence[object]]:
    for case in cases:
        if case.refused:
            yield (case.task, f"refused: {case.refused}", *[""] * 6)
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
        )


def _told(result: gp.OptimisedTrajectory, before: bool = False) -> str:
    if result.trajectory is None:
        return f"none: {result.detail}"
    same = " (-)" if result.status is gp.OptimisationStatus.UNCHANGED else ""
    begun = f"{result.initial_cost:.3f} to " if before else ""
    return f"{begun}{result.cost:.3f}{same} ({result.stats['seconds']:.1f})"


def _median(values: object) -> float:
    found = list(values)  # type: ignore[call-overload]
    return float(np.median(found)) if found else math.nan

"""Are motions as quick as their geometry allows, and worth what the planner thought?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.timing.trajectory import Trajectory

TITLE = "Motions: how quick, how smooth, and worth what the planner thought"
SECONDS = 1.0
W = (0.0, 0.3)
NOT_SLOWER = 0.1
CLOSE = (0.95, 1.05)
_GRID = 400
"""Points of the reference."""
_STOPPED = 0.02
"""Share of the greatest speed below which a motion stands still."""
_ENDS = 0.05
"""Share of a motion's length at both ends where it may."""
MEASURED = f"""\
`plan(time_limit={SECONDS:g})` at w = 0 and at the default weight, full speed, one seed. "Reference": toppra (TOPP-RA,
interpolating collocation, {_GRID} points) along a cubic spline through the samples of the same motion, within the same
limits of velocity and acceleration; "slower" is how much longer our motion takes. "At the limit": share of the time in
which some joint moves at 95 % or more of its velocity limit or accelerates at 90 % of that. "Stops": places in the
middle 90 % of the length where it all but stands still. "Turning": sum of the angles between neighbouring pieces of the
geometry; a straight line has none. "Estimate": J with which the descent of the motion ended, over J of what `plan`
returns.
"""


@dataclass(frozen=True, kw_only=True)
class Job:
    """A task and a weight."""

    task: str
    w: float


@dataclass(frozen=True, kw_only=True)
class Quickness:
    """What is found of a motion; NaN where there is none."""

    task: str
    w: float
    duration: float = np.nan
    slower: float = np.nan
    at_limit: float = np.nan
    stops: int = 0
    turning: float = np.nan
    estimate: float = np.nan


def run(options: suite.Options) -> str:
    """Plan every task at each weight, and measure."""
    jobs = [Job(task=name, w=w) for name in suite.task_names(options) for w in W]
    found = sorted(suite.spread(examine, jobs, 1, "motions"), key=lambda x: (x.w, jobs.index(Job(task=x.task, w=x.w))))
    header = ("task", "w", "duration", "slower than the reference", "at the limit", "stops", "turning", "estimate")
    return f"{MEASURED}\n{report.targets(_targets(found))}\n{report.table(header, map(_row, found))}"


def examine(job: Job) -> Quickness:
    """Plan one task."""
    task = suite.task(job.task)
    result = gp.plan(task.start, task.goal, task.scene, w=job.w, time_limit=SECONDS)
    motion = result.trajectory
    if motion is None or result.cost is None or len(motion) < 3:
        return Quickness(task=job.task, w=job.w)
    limits = task.scene.limits
    turns = np.diff(motion.path.without_duplicates().q, axis=0)
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    angles = np.arccos(np.clip(np.einsum("ij,ij->i", turns[1:], turns[:-1]), -1.0, 1.0))
    return Quickness(
        task=job.task,
        w=job.w,
        duration=motion.duration,
        slower=motion.duration / _reference(motion, limits) - 1.0,
        at_limit=_at_limit(motion, limits),
        stops=_stops(motion),
        turning=float(np.degrees(angles.sum())),
        estimate=result.stats.get("estimated_total", np.nan) / result.cost.total,
    )


def _reference(motion: Trajectory, limits: gp.Limits) -> float:
    """Duration of what toppra makes of the motion's geometry [s]."""
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint

    toppra.setup_logging("ERROR")
    q = motion.path.without_duplicates().q
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1)))
    curve = toppra.SplineInterpolator(s, q)
    velocity, acceleration = (np.stack([-x, x], axis=1) for x in (limits.velocity, limits.acceleration))
    constraints = [
        JointVelocityConstraint(velocity),
        JointAccelerationConstraint(acceleration, discretization_scheme=DiscretizationType.Interpolation),
    ]
    grid = np.linspace(0.0, s[-1], _GRID + 1)
    timed = TOPPRA(constraints, curve, gridpoints=grid).compute_trajectory(0.0, 0.0)
    return float("nan") if timed is None else float(timed.duration)


def _at_limit(motion: Trajectory, limits: gp.Limits) -> float:
    states = motion.at(np.linspace(motion.t[0], motion.t[-1], 1001))
    fast = (np.abs(states.qd) >= 0.95 * limits.velocity).any(axis=1)
    hard = (np.abs(states.qdd) >= 0.9 * limits.acceleration).any(axis=1)
    return float((fast | hard).mean())


def _stops(motion: Trajectory) -> int:
    """Count the stretches in the middle in which the motion all but stands still."""
    done = np.append(0.0, np.cumsum(motion.path.segment_lengths)) / motion.path.length
    speed = np.linalg.norm(motion.qd, axis=1)
    still = (speed < _STOPPED * speed.max()) & (done > _ENDS) & (done < 1.0 - _ENDS)
    return int((np.diff(still.astype(int)) == 1).sum())


def _targets(found: Sequence[Quickness]) -> Iterator[report.Target]:
    plain = [x for x in found if x.w == 0.0]
    late = [x.task for x in plain if not x.slower <= NOT_SLOWER]
    worst = max((x.slower for x in plain if np.isfinite(x.slower)), default=np.nan)
    yield report.Target(
        what="w = 0: longer than the time-optimal timing of the same geometry, worst task",
        wanted=f"<= {report.percent(NOT_SLOWER, 0)} on all {len(plain)}",
        measured=f"{report.percent(worst)}; {len(late)} beyond or without one {', '.join(late)}".rstrip(),
        met=not late,
    )
    stopped = [f"{x.task} (w {x.w:g})" for x in found if x.stops]
    yield report.Target(what="full stops inside", wanted="none", measured=", ".join(stopped) or "none", met=not stopped)
    ratios = [x.estimate for x in found if np.isfinite(x.estimate) and x.w > 0.0]
    median = float(np.median(ratios)) if ratios else np.nan
    least, most = CLOSE
    yield report.Target(
        what="estimate of the planner over J of the motion, median",
        wanted=f"{least:g} to {most:g}",
        measured=f"{median:.4f} ({min(ratios, default=np.nan):.3f} to {max(ratios, default=np.nan):.3f})",
        met=least <= median <= most if ratios else None,
    )


def _row(x: Quickness) -> list[str]:
    return [
        x.task,
        f"{x.w:g}",
        report.quantity(x.duration, " s"),
        report.percent(x.slower),
        report.percent(x.at_limit, 0),
        str(x.stops),
        f"{x.turning:.0f} deg",
        report.quantity(x.estimate, digits=4),
    ]

"""Takeovers from moving robots: motions to another goal from random moments of motions, against stopping first."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.mobile.floor.generated import floor_plan
from graceful_plan.query.endpoints.goals import Goal

TITLE = "Takeovers: motions from a robot that moves"
QUESTION = (
    "Do motions taken over from a moving robot continue its velocity, keep limits and contents, and reach the goal?"
)
HEADLINE = "takeovers with a velocity step"
DEPENDS_ON = (*suite.PLANNING, "src/graceful_plan/replanning.py")
COUNTS, LONG_COUNTS = (240, 24), (1000, 120)
"""Takeovers of arms and of a base, in normal and long runs."""
TASKS = (
    "tabletop/lift_to_goal",
    "tabletop/green_to_blue",
    "tabletop/right_to_left",
    "tabletop/far_to_near",
    "desk/put_book_away",
    "desk/lift_coffee",
)
SPEEDS = (1.0, 0.5)
"""Fractions of the velocity limits at which the motions that are left were planned."""
ITERATIONS = 15
"""Planner iterations of each plan, so that the load of the machine does not matter."""
BASE_SECONDS = 0.5
"""Time limit of each plan for a base [s]; a round of its planner takes longer than one iteration of the others."""
FLOORS = range(6)
"""Seeds of the generated floor plans that the Jackal crosses."""
BASE = "base (Jackal)"
STEP = 0.01
"""Largest accepted step of a velocity, relative to its limit."""
MEASURED = f"""\
Motions of {len(TASKS)} tasks with blocks, a book and a cup of coffee, planned at full and at half speed,
are left at random moments for the start or the goal of another task with the same object. "Takeover" is
`replan(goal=...)`, "stop and plan" is `plan_stop` at the same moment and `plan` from its end, both with
{ITERATIONS} iterations. Each motion is checked by exact geometry everywhere, sampled every millisecond for limits, and
joined with the motion before it for contents; stop and plan counts as solved only if its contents stay in, too.
"Speed left at" is the largest joint speed at the takeover, relative to its limit. Calls share the computer with those
of other processes.

The Jackal crosses {len(FLOORS)} generated floor plans (two rooms, 8 entities), and leaves its motion for the start or
the goal of that motion, in turn; each plan has {BASE_SECONDS} s. Rolling and the limits of its drive count as limits.
"""
_DT = 1e-3
_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Takeover:
    """One takeover, and stopping first for the same moment and goal. Durations [s] are NaN without a motion."""

    task: str
    speed: float
    share: float
    """Largest joint speed at the takeover, relative to its limit."""
    solved: bool
    duration: float
    stopped_duration: float
    step: float
    """Largest step of a joint velocity at the takeover, relative to its limit."""
    beyond: bool
    collides: bool
    spills: bool
    seconds: float


def run(options: suite.Options) -> str:
    """Measure takeovers, in turn of each task and speed."""
    arms, bases = options.pick(COUNTS, quick=(len(TASKS) * len(SPEEDS), len(FLOORS)), long=LONG_COUNTS)
    found = list(suite.spread(takeover, range(arms), options.processes, "takeovers"))
    found += suite.spread(base_takeover, range(bases), options.processes, "takeovers of a base")
    return f"{report.targets(targets(found))}\n{MEASURED}\n{table(found)}"


def targets(found: Sequence[Takeover]) -> Iterator[report.Target]:
    """Yield the targets."""
    for what, bad in (
        ("takeovers with a velocity step above 1 % of the limit", [one.step > STEP for one in found]),
        ("takeovers beyond a limit of velocity, acceleration or position", [one.beyond for one in found]),
        ("takeovers with a collision", [one.collides for one in found]),
        ("takeovers that spill", [one.spills for one in found]),
    ):
        yield report.Target(what=what, wanted="0", measured=f"{sum(bad)} of {len(found)}", met=not any(bad))
    both = [one for one in found if np.isfinite(one.stopped_duration)]
    also = sum(one.solved for one in both)
    yield report.all_done("takeovers solved where stop and plan is", also, len(both))


def table(found: Sequence[Takeover]) -> str:
    """Return shares and durations by kind of object and speed of the motion that is left."""
    rows = []
    for speed in SPEEDS:
        for kind, prefix in (("block", "tabletop/"), ("book", "desk/put"), ("cup", "desk/lift"), (BASE, "floor/")):
            mine = [one for one in found if one.speed == speed and one.task.startswith(prefix)]
            if not mine:
                continue
            both = [one for one in mine if one.solved and np.isfinite(one.stopped_duration)]
            ratio = [one.duration / one.stopped_duration for one in both if one.stopped_duration > 0.0]
            ms = 1e3 * np.array([one.seconds for one in mine])
            rows.append(
                (
                    kind,
                    f"{speed:g}",
                    str(len(mine)),
                    report.percent(float(np.mean([one.solved for one in mine]))),
                    report.percent(float(np.mean([np.isfinite(one.stopped_duration) for one in mine]))),
                    f"{np.median(ratio):.2f}" if ratio else "",
                    f"{np.median([one.share for one in mine]):.2f}",
                    f"{np.median(ms):.0f}",
                    f"{ms.max():.0f}",
                )
            )
    heads = ("object", "speed", "n", "solved", "stop and plan", "duration, over stop and plan", "speed left at")
    return report.table((*heads, "call [ms]", "most"), rows)


@cache
def _motion(name: str, speed: float) -> gp.Trajectory:
    task = suite.task(name)
    return gp.plan(task.start, task.goal, task.scene, speed=speed, iterations=100).unwrap()


@cache
def _drive(floor: int) -> tuple[gp.Scene, gp.Trajectory]:
    made = floor_plan(floor, rooms=(2, 1), people=8)
    scene = made.floor.to_scene("jackal")
    return scene, gp.plan(made.start, gp.BasePose(*made.goal[:2]), scene, time_limit=2.0).unwrap()


def _goals(name: str) -> list[Goal]:
    """Return the starts and goals of tasks in the same scene with the same object."""
    mine, scene = suite.task(name), name.partition("/")[0]
    others = [suite.task(other) for other in suite.task_names() if other.partition("/")[0] == scene]
    same = [one for one in others if one.scene.carried is not None and one.scene.carried == mine.scene.carried]
    return [goal for one in same or [mine] for goal in (one.start, one.goal)]


def takeover(seed: int) -> Takeover:
    """Return one random takeover; seeds go through tasks and speeds in turn."""
    cases = [(name, speed) for name in TASKS for speed in SPEEDS]
    name, speed = cases[seed % len(cases)]
    motion, scene, rng = _motion(name, speed), suite.task(name).scene, np.random.default_rng(seed)
    at = float(rng.uniform(0.02, 0.98)) * motion.duration
    goals = _goals(name)
    goal = goals[rng.integers(len(goals))]
    return _measured(Case(name, scene, motion, goal, speed, {"iterations": ITERATIONS}), at, seed)


def base_takeover(seed: int) -> Takeover:
    """Return one random takeover of a Jackal; seeds go through floor plans, then goals, in turn."""
    floor = FLOORS[seed % len(FLOORS)]
    scene, motion = _drive(floor)
    back = seed // len(FLOORS) % 2 == 0
    at = float(np.random.default_rng(seed).uniform(0.02, 0.98)) * motion.duration
    case = Case(f"floor/{floor}", scene, motion, motion.q[0 if back else -1], 1.0, {"time_limit": BASE_SECONDS})
    return _measured(case, at, seed)


@dataclass(frozen=True)
class Case:
    """A motion that is left for a goal; `speed` is the one that it was planned with, `budget` that of a plan."""

    task: str
    scene: gp.Scene
    motion: gp.Trajectory
    goal: Goal
    speed: float
    budget: dict[str, Any]


def _measured(case: Case, at: float, seed: int) -> Takeover:
    scene, motion, state = case.scene, case.motion, case.motion.at(at)
    began = time.perf_counter()
    result = gp.replan(motion, scene, at=at, goal=case.goal, seed=seed, **case.budget)
    seconds = time.perf_counter() - began
    solved, trajectory = result.status is gp.PlanStatus.SOLVED, result.trajectory
    step, duration = 0.0, np.nan
    beyond = collides = spills = False
    if trajectory is not None:
        step = float((np.abs(trajectory.qd[0] - state.qd) / scene.limits.velocity).max())
        duration = trajectory.duration
        exact = gp.verify(trajectory, scene, start=state, before=motion)
        beyond = _beyond(trajectory, scene) or not {"rolling", "drive_limits"}.isdisjoint(exact.failures)
        collides, spills = "collision" in exact.failures, "contents" in exact.failures
    return Takeover(
        task=case.task,
        speed=case.speed,
        share=float((np.abs(state.qd) / scene.limits.velocity).max()),
        solved=solved,
        duration=duration,
        stopped_duration=_stopped(case, at, seed),
        step=step,
        beyond=beyond,
        collides=collides,
        spills=spills,
        seconds=seconds,
    )


def _stopped(case: Case, at: float, seed: int) -> float:
    """Return the duration of a stop and a plan from its end [s]; NaN if one of them fails."""
    scene, motion = case.scene, case.motion
    stop = gp.plan_stop(motion, scene, at=at).trajectory
    if stop is None:
        return np.nan
    onward = gp.plan(stop.q[-1], case.goal, scene, seed=seed, **case.budget).trajectory
    if onward is None:
        return np.nan
    onward = onward.later(float(stop.t[-1]))
    if "contents" in gp.verify(onward, scene, before=motion.spliced(stop)).failures:
        return np.nan  # a liquid that swings after the stop
    return stop.duration + onward.duration


def _beyond(trajectory: gp.Trajectory, scene: gp.Scene) -> bool:
    t = trajectory.t[0] + np.linspace(0.0, trajectory.duration, 2 + int(trajectory.duration / _DT))
    state = trajectory.at(np.minimum(t, trajectory.t[-1]))
    lower, upper = scene.limits.position.T
    most = 1.0 + _TOLERANCE
    inside = (state.q >= lower - _TOLERANCE) & (state.q <= upper + _TOLERANCE)
    slow = np.abs(state.qd) <= most * scene.limits.velocity
    gentle = np.abs(state.qdd) <= most * scene.limits.acceleration
    return not bool(inside.all() and slow.all() and gentle.all())

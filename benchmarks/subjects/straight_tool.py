"""Straight motions of the tool: how many lines are travelled, how straight, in what time, and what stops the others?"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.core.compile import compile_scene

TITLE = "Straight motions of the tool"
LENGTH = 0.3
"""Of each line [m]."""
TURN = np.deg2rad(30.0)
"""Largest turn along a line [rad]."""
CLEARANCE = 0.01
"""Of configurations drawn at random [m], so that lines do not end where they begin."""
SAMPLES = 500
"""Times of each motion at which the tool is looked at."""
WANTED = (1e-3, float(np.deg2rad(0.5)))
"""Bounds of distance [m] and angle [rad]: those of the library by default."""
MEASURED = """\
Lines of 0.3 m in directions drawn uniformly, 200 of each group, in all bundled scenes by turns. "Tasks": from the start
or a goal of a bundled task, its object in the gripper, orientation kept. "Turning": the same with a turn of up to 30°
about a random axis. "Anywhere": turning too, from configurations drawn uniformly within the joint limits with 1 cm of
clearance, empty-handed; many of these lines leave the robot's reach. "Goal possible" are lines whose last pose has a
configuration within the limits that is free of collision; others cannot be travelled by anybody. Deviations are
distances from the line and angles to the orientation at the nearest place on it, by MuJoCo's kinematics at 500 times
of each motion.
"""
GROUPS = ("tasks", "turning", "anywhere")

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class LineFigures:
    """What came of one line."""

    group: str
    seconds: float
    status: str
    reason: str
    """In a word, if it was not solved."""
    deviation: float
    """Of a solved one [m]."""
    angle: float
    """Of a solved one [rad]."""
    duration: float
    """Of a solved one [s]."""


def run(options: suite.Options) -> str:
    """Measure random lines in every scene."""
    count = options.pick(200, quick=12)
    # One process: queries of some milliseconds are not to be shared with anybody.
    jobs = [(group, count) for group in GROUPS]
    found = [f for figures in suite.spread(examine, jobs, 1, "straight motions") for f in figures]
    header = (
        "lines", "drawn", "goal possible", "solved", "of possible", "deviation, median [mm]", "worst",
        "angle, worst [°]", "query, median [ms]", "95 %", "slowest", "not solved, median [ms]",
    )  # fmt: skip
    rows = [_row(group, [f for f in found if f.group == group]) for group in GROUPS]
    reasons = Counter((f.group, f.reason) for f in found if f.status == "INFEASIBLE")
    why = [[group, reason, str(n)] for (group, reason), n in sorted(reasons.items())]
    table = report.table(("lines", "goal possible, not solved: why", "lines that"), why)
    return f"{MEASURED}\n{report.targets(_targets(found))}\n{report.table(header, rows)}\n{table}"


def examine(job: tuple[str, int]) -> list[LineFigures]:
    """Measure one group of lines."""
    group, count = job
    rng = np.random.default_rng(0)
    found = []
    for i in range(count):
        scene, q = _anywhere(i, rng) if group == "anywhere" else _of_tasks(i, rng)
        direction, axis = rng.normal(size=(2, 3))
        turn = 0.0 if group == "tasks" else rng.uniform(0.0, TURN)
        goal = gp.PoseGoal.from_tool(
            q,
            scene,
            translation=LENGTH * direction / np.linalg.norm(direction),
            rotation=turn * axis / np.linalg.norm(axis),
        )
        if i == 0:
            gp.plan_cartesian(q, goal, scene)  # the first one warms up
        found.append(_examine(group, q, goal, scene))
    return found


def _of_tasks(i: int, rng: np.random.Generator) -> tuple[gp.Scene, Array]:
    names = suite.task_names()
    task = suite.task(names[i % len(names)])
    ends = [task.start, *np.atleast_2d(task.goal)]
    return task.scene, ends[rng.integers(len(ends))]


def _anywhere(i: int, rng: np.random.Generator) -> tuple[gp.Scene, Array]:
    scene = suite.scene(gp.scenes()[i % len(gp.scenes())])
    kernels = compile_scene(scene).kernels
    while True:
        q = rng.uniform(*scene.limits.position.T)
        if kernels.free(q, CLEARANCE):
            return scene, q


def _examine(group: str, q: Array, goal: gp.PoseGoal, scene: gp.Scene) -> LineFigures:
    started = time.perf_counter()
    result = gp.plan_cartesian(q, goal, scene)
    seconds = time.perf_counter() - started
    deviation, angle, duration = np.nan, np.nan, np.nan
    if result.status is gp.PlanStatus.SOLVED:
        trajectory = result.unwrap()
        deviation, angle = _worst(trajectory, goal, scene)
        duration = trajectory.duration
    return LineFigures(
        group=group,
        seconds=seconds,
        status=result.status.name,
        reason=_reason(result),
        deviation=deviation,
        angle=angle,
        duration=duration,
    )


def _reason(result: gp.PlanResult) -> str:
    words = {"held by the limit": "end at joint limits", "collision": "collide", "singular": "meet a singularity"}
    return next((told for word, told in words.items() if word in result.detail), "move too suddenly")


def _worst(trajectory: gp.Trajectory, goal: gp.PoseGoal, scene: gp.Scene) -> tuple[float, float]:
    """Worst distance from the line [m], and angle to the orientation at the nearest place on it [rad]."""
    data = mujoco.MjData(scene.model)
    p, quat = np.empty((SAMPLES, 3)), np.empty((SAMPLES, 4))
    for k, q in enumerate(trajectory.at(np.linspace(trajectory.t[0], trajectory.t[-1], SAMPLES)).q):
        data.qpos[scene.qpos_adr] = q
        mujoco.mj_kinematics(scene.model, data)
        p[k] = data.site(scene.tool).xpos
        mujoco.mju_mat2Quat(quat[k], data.site(scene.tool).xmat)
    whole, last, turn = goal.X_WT[:3, 3] - p[0], np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(last, goal.X_WT[:3, :3].ravel())
    mujoco.mju_subQuat(turn, last, quat[0])  # in the frame of the first orientation
    share = np.clip((p - p[0]) @ whole / (whole @ whole), 0.0, 1.0)
    angles, missing = np.empty(SAMPLES), np.empty(3)
    for k in range(SAMPLES):
        due = quat[0].copy()
        mujoco.mju_quatIntegrate(due, turn, float(share[k]))
        mujoco.mju_subQuat(missing, quat[k], due)
        angles[k] = np.linalg.norm(missing)
    return float(np.linalg.norm(p - p[0] - share[:, None] * whole, axis=1).max()), float(angles.max())


def _row(group: str, found: list[LineFigures]) -> list[str]:
    possible = [f for f in found if f.status not in ("INVALID_GOAL", "INVALID_START")]
    solved = [f for f in found if f.status == "SOLVED"]
    others = [1e3 * f.seconds for f in found if f.status != "SOLVED"]
    milliseconds = [1e3 * f.seconds for f in solved]
    return [
        group,
        str(len(found)),
        str(len(possible)),
        str(len(solved)),
        report.percent(len(solved) / max(1, len(possible))),
        f"{1e3 * np.median([f.deviation for f in solved]):.4f}",
        f"{1e3 * max(f.deviation for f in solved):.3f}",
        f"{np.rad2deg(max(f.angle for f in solved)):.4f}",
        f"{np.median(milliseconds):.0f}",
        f"{np.quantile(milliseconds, 0.95):.0f}",
        f"{max(milliseconds):.0f}",
        f"{np.median(others):.0f}" if others else "",
    ]


def _targets(found: list[LineFigures]) -> Iterator[report.Target]:
    solved = [f for f in found if f.status == "SOLVED"]
    worst, angle = max(f.deviation for f in solved), max(f.angle for f in solved)
    yield report.Target(
        what="worst deviation of a motion that was returned",
        wanted="< 1 mm",
        measured=f"{1e3 * worst:.3f} mm",
        met=worst < WANTED[0],
    )
    yield report.Target(
        what="worst angle to the orientation due",
        wanted="< 0.5°",
        measured=f"{np.rad2deg(angle):.4f}°",
        met=angle < WANTED[1],
    )
    told = sum(f.status in ("INFEASIBLE", "INVALID_GOAL", "INVALID_START") for f in found)
    yield report.Target(
        what="others with a status that says where and why",
        wanted="all",
        measured=f"{told} of {len(found) - len(solved)}",
        met=told == len(found) - len(solved),
    )

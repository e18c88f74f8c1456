"""Pose goals: share solved, error, time, and number of seeds that reach the pose."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.query.endpoints.ik import draw_seeds, solve_ik
from graceful_plan.query.endpoints.pose_solver import PoseSolver
from graceful_plan.scene.pose_goal import pose_error

TITLE = "Inverse kinematics: goals given as a pose"
QUESTION = "Are reachable tool poses solved, how exactly and how fast?"
HEADLINE = "reachable poses"
DEPENDS_ON = ("src/graceful_plan/query/endpoints", "src/graceful_plan/core", "src/graceful_plan/scene")
SEEDS = 32
"""Seeds per round of the search, the default of `solve_ik`."""
ITERATIONS = 60
EXACT = 1e-6
"""Largest error of a solution [m, rad]."""
MEASURED = """\
Tool poses of configurations drawn uniformly within the joint limits, so all can be reached; ten per bundled scene, as
full poses and with free yaw. "Solved" and "query": `solve_ik` from the task's start, at most eight distinct solutions,
collisions ignored. Errors are those of all solutions. "Arrived": seeds that the core brings to their pose, out of one
round of 32 seeds per pose.
"""

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class PoseFigures:
    """Result for one pose."""

    free_yaw: bool
    seconds: float
    solutions: Array
    """Errors of the solutions [m, rad]."""
    arrived: int
    """Seeds of one round that reach the pose."""


def run(options: suite.Options) -> str:
    """Measure random poses in every scene."""
    per_scene = 1 if options.quick else 10
    jobs = [(name, free_yaw, per_scene) for name in gp.scenes() for free_yaw in (False, True)]
    # One process: other processes would disturb queries of a few milliseconds.
    findings = [f for found in suite.spread(examine, jobs, 1, "inverse kinematics") for f in found]
    header = (
        "goal", "poses", "solved", "query, median [ms]", "slowest [ms]", "error, median", "worst",
        "seeds", "arrived",
    )  # fmt: skip
    rows = [_row(word, [f for f in findings if f.free_yaw == yaw]) for word, yaw in (("pose", 0), ("free yaw", 1))]
    return f"{MEASURED}\n{report.targets(_targets(findings))}\n{report.table(header, rows)}"


def examine(job: tuple[str, bool, int]) -> list[PoseFigures]:
    """Measure poses in one scene."""
    name, free_yaw, count = job
    task = next(iter(suite.scene(name).tasks.values()))
    rng = np.random.default_rng(0)
    goals = [
        gp.PoseGoal(_tool(task.scene, q), free_yaw=free_yaw)
        for q in rng.uniform(*task.scene.limits.position.T, size=(count, len(task.start)))
    ]
    solve_ik(goals[0], task.scene, task.start)  # warm-up
    return [_examine(goal, task.scene, task.start) for goal in goals]


def _examine(goal: gp.PoseGoal, scene: gp.Scene, start: Array) -> PoseFigures:
    started = time.perf_counter()
    found = solve_ik(goal, scene, start)
    seconds = time.perf_counter() - started
    solver = PoseSolver(goal, scene)
    arrived, _ = solver.search(draw_seeds(scene, start, SEEDS, np.random.default_rng(0), 0), ITERATIONS)
    return PoseFigures(
        free_yaw=goal.free_yaw,
        seconds=seconds,
        solutions=_errors(goal, scene, found.q),
        arrived=len(arrived),
    )


def _tool(scene: gp.Scene, q: Array) -> Array:
    X_WT, site = np.eye(4), scene.data_at(q).site(scene.tool)
    X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    return X_WT


def _errors(goal: gp.PoseGoal, scene: gp.Scene, q: Array) -> Array:
    return np.array([pose_error(goal, _tool(scene, x)) for x in q]).reshape(-1, 2)


def _row(word: str, findings: list[PoseFigures]) -> list[str]:
    milliseconds = [1e3 * f.seconds for f in findings]
    solutions = np.concatenate([f.solutions for f in findings])
    return [
        word,
        str(len(findings)),
        str(sum(len(f.solutions) > 0 for f in findings)),
        f"{np.median(milliseconds):.2f}",
        f"{np.max(milliseconds):.1f}",
        _errors_text(np.median(solutions, axis=0)),
        _errors_text(solutions.max(axis=0)),
        str(SEEDS * len(findings)),
        str(sum(f.arrived for f in findings)),
    ]


def _errors_text(error: Array) -> str:
    return f"{error[0]:.1e} m, {error[1]:.1e} rad"


def _targets(findings: list[PoseFigures]) -> Iterator[report.Target]:
    solved = sum(len(f.solutions) > 0 for f in findings)
    yield report.Target(
        what="reachable poses that are solved",
        wanted="100 %",
        measured=f"{solved} of {len(findings)}",
        met=solved == len(findings),
    )
    worst = max(float(f.solutions.max(initial=0.0)) for f in findings)
    yield report.Target(
        what="worst error of a solution",
        wanted=f"< {EXACT:g} m and rad",
        measured=f"{worst:.1e}",
        met=bool(solved) and worst < EXACT,
    )

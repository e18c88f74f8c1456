"""plan(w=0): does it always find a path, and how long does the search take to the first one?"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from graceful_plan.compare import Run
from graceful_plan.compare.runs.runner import run as run_planner
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.endpoints.escape import way_out

TITLE = "First path: plan(w=0) on every task"
PLANNERS = ("anytime", "rrt_connect")
FIRST_WITHIN = 0.001
TIME_LIMIT = 5.0
MEASURED = f"""\
"Search" is the planner alone, from the call of `solve` to its first collision-free path, everything loaded and
compiled; starts and goals that are tight for the spheres are left first, as `plan` does. "Whole call" is `plan(w=0,
planner="rrt_connect", time_limit={TIME_LIMIT:g})`: goals checked, search, shortcuts, timing by TOPP-RA, exact
verification. "Straight" says whether the straight line is free, so that there is nothing to search.
"""


@dataclass(frozen=True, kw_only=True)
class FirstPaths:
    """What came of one task."""

    task: str
    straight: bool
    search: dict[str, list[float]]
    """Seconds of every seed, by planner; infinite if no path was found."""
    calls: list[Run]


def run(options: suite.Options) -> str:
    """Measure every task."""
    seeds = 2 if options.quick else 20
    names = suite.task_names(options)
    order = {name: i for i, name in enumerate(names)}
    # One process: times below a millisecond are not to be shared with anybody.
    findings = suite.spread(examine, [(name, seeds) for name in names], 1, "first path")
    findings = sorted(findings, key=lambda f: order[f.task])
    header = ("task", "straight", *(f"search, {p} [ms]" for p in PLANNERS), "slowest", "solved", "whole call [ms]")
    rows = [_row(finding) for finding in findings]
    return f"{MEASURED}\n{seeds} seeds; medians.\n\n{report.targets(_targets(findings))}\n{report.table(header, rows)}"


def examine(job: tuple[str, int]) -> FirstPaths:
    """Measure one task."""
    name, seeds = job
    problem = problem_of(suite.task(name))
    search: dict[str, list[float]] = {planner: [np.inf] * seeds for planner in PLANNERS}
    straight = False
    if problem is not None:
        instance = suite.task(name)
        search = {planner: _search(planner, problem, instance.scene, seeds) for planner in PLANNERS}
        starts = np.broadcast_to(problem.start, problem.goals.shape)
        straight = bool(problem.edges_free(starts, problem.goals).any())
    jobs = [planning.job(name, "rrt_connect", seed=seed, w=0.0, seconds=TIME_LIMIT) for seed in range(seeds)]
    return FirstPaths(task=name, straight=straight, search=search, calls=[run_planner(job) for job in jobs])


def problem_of(task: gp.Task, margin: float = 0.0) -> SceneProblem | None:
    """Make the problem that planners see, None if start or goals have no way out."""
    kernels, rng = compile_scene(task.scene).kernels, np.random.default_rng(0)
    anything = SceneConstraints(task.scene, ())
    start = way_out(task.start, anything, rng)
    goals = [way for goal in task.goal if (way := way_out(goal, anything, rng)) is not None]
    if start is None or not goals:
        return None
    return SceneProblem(kernels=kernels, start=start.q[-1], goals=np.stack([way.q[-1] for way in goals]), margin=margin)


def _search(planner: str, problem: SceneProblem, scene: gp.Scene, seeds: int) -> list[float]:
    objective = gp.Objective(w=0.0).bind(scene)
    solver = gp.PLANNERS[planner]()
    seconds = []
    for seed in [0, *range(seeds)]:  # the first one warms up
        rng = np.random.default_rng(seed)
        started = time.perf_counter()
        found = next(iter(solver.solve(problem, objective, Budget(TIME_LIMIT), rng)), None)
        seconds.append(time.perf_counter() - started if found is not None else np.inf)
    return seconds[1:]


def _row(finding: FirstPaths) -> list[str]:
    medians = [f"{1e3 * float(np.median(finding.search[planner])):.2f}" for planner in PLANNERS]
    slowest = f"{1e3 * max(max(times) for times in finding.search.values()):.1f}"
    solved = sum(record.solved for record in finding.calls)
    calls = f"{1e3 * float(np.median([record.seconds for record in finding.calls])):.0f}"
    failures = sorted({record.status for record in finding.calls if not record.solved})
    told = f"{solved}/{len(finding.calls)}" + (f" {', '.join(failures)}" if failures else "")
    return [finding.task, "yes" if finding.straight else "no", *medians, slowest, told, calls]


def _targets(findings: list[FirstPaths]) -> Iterator[report.Target]:
    records = [record for finding in findings for record in finding.calls]
    solved = sum(record.solved for record in records)
    yield report.Target(
        what="calls of plan(w=0) that are SOLVED",
        wanted="100 %",
        measured=f"{report.percent(solved / len(records))} ({solved} of {len(records)})",
        met=solved == len(records),
    )
    for planner in PLANNERS:
        times = [seconds for finding in findings for seconds in finding.search[planner]]
        tasks = [float(np.median(finding.search[planner])) for finding in findings]
        searched = [seconds for finding in findings if not finding.straight for seconds in finding.search[planner]]
        median = float(np.median(times))
        yield report.Target(
            what=f"median search to the first path, {planner}",
            wanted="< 1 ms",
            measured=f"{1e3 * median:.2f} ms; worst task's median {1e3 * max(tasks):.2f} ms; "
            f"median where the straight line is not free {1e3 * float(np.median(searched or [np.nan])):.2f} ms",
            met=median < FIRST_WITHIN,
        )

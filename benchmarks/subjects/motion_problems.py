"""plan(w=0) on problems of the MotionBenchMaker type: share solved, search time, time to a verified motion, length."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.motion_problems import KINDS, make, write
from benchmarks.tight_ends import TightEnds, tight_ends
from graceful_plan.compare.problems.problem_files import ProblemFile
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.endpoints.endpoints import ways_out
from graceful_plan.query.endpoints.goals import resolve_goal, resolve_start
from graceful_plan.query.endpoints.travel import Travel

Array = np.ndarray

TITLE = "Problem files: plan(w=0) on problems of the MotionBenchMaker type"
QUESTION = "How many problems of the MotionBenchMaker type are solved, and how fast?"
HEADLINE = "problems that"
DEPENDS_ON = (
    *suite.PLANNING,
    "src/graceful_plan/compare/problems",
    "benchmarks/motion_problems.py",
    "benchmarks/tight_ends.py",
)
FILE = "MOTION_PROBLEMS"
"""Environment variable with the path of a problem file or folder to use instead of the generated problems."""
SEED = 7
TIME_LIMIT = 5.0
MARKS = (0.005, 0.01, 0.02, 0.1)
"""Times at which the path of the anytime planner is measured [s]."""
LENGTHS = {0.01: 4.40, 0.1: 4.25}
"""Targets on the problems of MotionBenchMaker: median length [rad] by time [s]."""
VAMP_SEARCH = 0.075e-3
"""Published median of VAMP's search on these problems [s]."""
LONG = 2.0
"""Duration of the long run that lengths are compared with [s]."""
LONG_EVERY = 4
"""Every n-th problem has a long run."""
MEASURED = f"""\
"Search": RRT-Connect alone, from the call of `solve` to its first collision-free path with 2 mm of clearance, scene
compiled. "Verified": a whole call of `plan` that ends with the first path, including exact checks of both ends, timing
by TOPP-RA and exact verification of the timed motion. "Length": joint-space length of the path of the `anytime` planner
at w = 0 after the given time. "Ratio": this length over the length after {LONG:g} s on the same problem and seed, for
one problem in {LONG_EVERY}; it depends less on the machine and the problems than the length does.

Unless `{FILE}` names a file, the problems are **generated** by `benchmarks/motion_problems.py`, after the published
description of MotionBenchMaker's seven kinds for the Panda. They are not the original problems: sizes, targets and the
choice among inverse-kinematics solutions differ. Lengths and times therefore do not compare with published figures
(VAMP: median 0.075 ms search, 0.19 ms simplification, length 4.90; AORRTC: 4.40 after 6 to 40 ms). The targets for the
median length, 4.40 rad within 10 ms and 4.25 rad within 100 ms, are for the original problems and are only judged if
`{FILE}` names a file. A generated problem is kept only if RRT-Connect with another seed and range solves it within 10
s, so some of the hardest are missing, as in the original set.

"Refused": configurations that `plan` would refuse as a start or a goal, although exact geometry calls them free. They
are drawn in two scenes of each kind, uniformly and around goals; the covering spheres have less than 2 mm of clearance.
"""


@dataclass(frozen=True, kw_only=True)
class ProblemFigures:
    """Result for one problem."""

    name: str
    group: str
    search: tuple[float, ...]
    """Search time of every seed [s]; infinite without a path."""
    lengths: tuple[float, ...]
    """Lengths of the first path and at `MARKS` [rad]."""
    ratios: tuple[float, ...] | None
    """The lengths divided by the length of the long run."""
    status: str
    verified: float
    """Duration of the whole call [s]."""


def run(options: suite.Options) -> str:
    """Measure every problem, in one process: others would disturb times below a millisecond."""
    given = os.environ.get(FILE)
    if given:
        problems, origin = gp.load_problems(given), f"The problems are those of `{Path(given).name}`."
    else:
        problems, origin = _own(options.pick(20, quick=2, long=30), options), f"Own problems, seed {SEED}."
    seeds = 2 if options.quick else 5
    jobs = [(problem, seeds, i % LONG_EVERY == 0) for i, problem in enumerate(problems)]
    findings = list(suite.spread(examine, jobs, 1, "motion problems"))
    groups = list(dict.fromkeys(finding.group for finding in findings))
    rows = [_row(group, [f for f in findings if f.group == group]) for group in groups]
    rows.append(_row("all", findings))
    marks = [f"at {1e3 * mark:g} ms" for mark in MARKS]
    header = ("kind", "problems", "solved", "search [ms]", "95 %", "slowest", "verified [ms]", "first length [rad]",
              *(f"length {mark}" for mark in marks), *(f"ratio {mark}" for mark in marks))  # fmt: skip
    statuses = [f"{f.name}: {f.status}" for f in findings if f.status != "SOLVED"]
    failed = f"\nNot solved: {'; '.join(statuses)}.\n" if statuses else ""
    some = [problem for group in groups for problem in [p for p in problems if p.group == group][:2]]
    targets = report.targets([*_targets(findings, own=not given), _refusals(tight_ends(some))])
    return f"{MEASURED}\n{origin} {seeds} seeds; medians.\n\n{targets}\n{report.table(header, rows)}{failed}"


def _own(count: int, options: suite.Options) -> Sequence[ProblemFile]:
    """Generate problems, write them to a file and read them back."""
    made = suite.spread(_make, [(kind, count) for kind in KINDS], options.processes, "making problems")
    by_kind = {problems[0].group: problems for problems in made}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "problems.yaml"
        write([problem for kind in KINDS for problem in by_kind[kind]], file)
        return gp.load_problems(file)


def _make(job: tuple[str, int]) -> list[ProblemFile]:
    return [_without_scene(problem) for problem in make(*job, SEED)]


def _without_scene(problem: ProblemFile) -> ProblemFile:
    """Copy a problem without its cached scene, so that it can be sent to another process."""
    return ProblemFile(**{name: getattr(problem, name) for name in problem.__dataclass_fields__})


def examine(job: tuple[ProblemFile, int, bool]) -> ProblemFigures:
    """Measure one problem."""
    problem, seeds, long = job
    searched = _search_problem(problem)
    search: tuple[float, ...] = (np.inf,) * seeds
    lengths: tuple[float, ...] = (np.inf,) * (1 + len(MARKS))
    ratios = None
    if searched is not None:
        objective = gp.Objective(w=0.0).bind(problem.scene)
        search = tuple(_search(searched, objective, seed) for seed in [0, *range(seeds)])[1:]  # warm-up
        *lengths_, last = _lengths(searched, objective, LONG if long else MARKS[-1])
        lengths = tuple(lengths_)
        ratios = tuple(length / last for length in lengths) if long and np.isfinite(last) else None
    started = time.perf_counter()
    result = gp.plan(
        problem.start, problem.goal, problem.scene, w=0.0, time_limit=TIME_LIMIT, callback=lambda point: True
    )
    return ProblemFigures(
        name=problem.name,
        group=problem.group,
        search=search,
        lengths=lengths,
        ratios=ratios,
        status=result.status.name,
        verified=time.perf_counter() - started if result.status is gp.PlanStatus.SOLVED else np.inf,
    )


def _search_problem(problem: ProblemFile) -> SceneProblem | None:
    """Return the problem as `plan` passes it to planners; None if start or goals are invalid."""
    scene, compiled = problem.scene, compile_scene(problem.scene)
    start = resolve_start(problem.start, scene).q
    goals = resolve_goal(problem.goal, scene, problem.start).q
    if not len(start) or not len(goals):
        return None
    ends = ways_out(Travel(start[0]), goals, SceneConstraints(scene, ()), np.random.default_rng(0))
    if isinstance(ends, gp.PlanResult):
        return None
    return SceneProblem(
        kernels=compiled.kernels,
        start=ends.departure.q[-1],
        goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
        margin=min(0.002, 0.5 * ends.clearance),
    )


def _search(problem: SceneProblem, objective: SceneObjective, seed: int) -> float:
    planner, rng = gp.RRTConnect(shortcut=None), np.random.default_rng(seed)
    started = time.perf_counter()
    found = next(iter(planner.solve(problem, objective, Budget(TIME_LIMIT), rng)), None)
    return time.perf_counter() - started if found is not None else np.inf


def _lengths(problem: SceneProblem, objective: SceneObjective, seconds: float) -> list[float]:
    """Return the length of the first path, those at `MARKS`, and that at the end."""
    budget = Budget(seconds)
    trace = [
        (budget.elapsed, path.length)
        for path in gp.Anytime().solve(problem, objective, budget, np.random.default_rng(1))
    ]
    at_marks = [min((length for at, length in trace if at <= mark), default=np.inf) for mark in MARKS]
    return [trace[0][1] if trace else np.inf, *at_marks, trace[-1][1] if trace else np.inf]


def _row(group: str, findings: list[ProblemFigures]) -> list[str]:
    times = 1e3 * np.array([seconds for finding in findings for seconds in finding.search])
    lengths = np.median([finding.lengths for finding in findings], axis=0)
    ratios = [finding.ratios[1:] for finding in findings if finding.ratios is not None]
    solved = sum(finding.status == "SOLVED" for finding in findings)
    return [
        group,
        str(len(findings)),
        f"{solved}/{len(findings)}",
        f"{np.median(times):.3f}",
        f"{np.percentile(times, 95, method='higher'):.2f}",
        f"{times.max():.1f}",
        f"{1e3 * float(np.median([finding.verified for finding in findings])):.0f}",
        *(f"{length:.2f}" for length in lengths),
        *(f"{ratio:.3f}" for ratio in (np.median(ratios, axis=0) if ratios else [np.nan] * len(MARKS))),
    ]


def _targets(findings: list[ProblemFigures], own: bool) -> Iterator[report.Target]:
    solved = sum(finding.status == "SOLVED" for finding in findings)
    yield report.Target(
        what="problems that plan(w=0) solves",
        wanted="100 %",
        measured=f"{report.percent(solved / len(findings))} ({solved} of {len(findings)})",
        met=solved == len(findings),
    )
    median = 1e3 * float(np.median([seconds for finding in findings for seconds in finding.search]))
    yield report.Target(
        what="median search to the first path", wanted="< 1 ms", measured=f"{median:.3f} ms", met=median < 1.0
    )
    most = 3.0 * VAMP_SEARCH
    yield report.Target(
        what="the same, three times that of VAMP",
        wanted=f"<= {1e3 * most:.3f} ms",
        measured=f"{median:.3f} ms",
        met=median <= 1e3 * most,
    )
    for mark, most in () if own else LENGTHS.items():  # targets for the original problems
        length = float(np.median([finding.lengths[1 + MARKS.index(mark)] for finding in findings]))
        yield report.Target(
            what=f"median length after {1e3 * mark:g} ms",
            wanted=f"<= {most:.2f} rad",
            measured=f"{length:.2f} rad",
            met=length <= most,
        )


def _refusals(ends: TightEnds) -> report.Target:
    return report.Target(
        what=f"refused of {ends.tight} tight configurations that exact geometry accepts",
        wanted="0",
        measured=str(ends.refused),
        met=ends.refused == 0,
    )

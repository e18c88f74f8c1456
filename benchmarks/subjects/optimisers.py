"""Trajectory optimisers: known optima, what they make of a good path in a second, and their gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

import graceful_plan as gp
from benchmarks import gradients, planning, report, suite
from benchmarks.subjects.first_path import problem_of
from graceful_plan.compare.problems.analytic import analytic_problems
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.optimisers.optimiser import Optimiser
from graceful_plan.planners.planner import Budget, Planner, path_total
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.shortcut import Shortcut
from graceful_plan.query.candidates.search import is_solution

Array = np.ndarray

TITLE = "Optimisers: known optima, better than shortcuts, exact gradients"
FINER = 50
WITHIN = {"stomp": 0.02}
"""J / J* - 1 allowed on smooth problems with a known optimum."""
WITHIN_ELSE = 0.005
SHARE_LOWERED = 0.9
GRADIENT_ERROR = 1e-5
MARGIN = 0.002
"""Clearance that `plan` keeps in its first search [m]."""
MORE_SHORTCUTS = "more shortcuts"
SMOOTH = ("free_space", "uniform_density", "hyperbolic", "catenary")
BEGIN: dict[str, Array] = {
    "free_space": np.array([[-1.0, -1.0], [-1.5, 0.5], [0.5, 1.5], [0.5, 0.5]]),
    "uniform_density": np.array([[-1.0, -1.0], [-1.5, 0.5], [0.5, 1.5], [0.5, 0.5]]),
    "disc": np.array([[-2.0, 0.0], [-2.5, 2.0], [1.0, 2.8], [2.0, 0.0]]),
    "two_media": np.array([[0.0, 1.0], [-1.0, -1.0], [2.5, 0.5], [2.0, -1.0]]),
    "hyperbolic": np.array([[0.0, 0.5], [-0.3, 0.2], [0.5, 0.15], [1.0, 0.5]]),
    "catenary": np.array([[-1.0, 2.0], [-1.5, 2.8], [1.5, 2.8], [1.0, 2.0]]),
}
"""Where optimisers begin: detours of the right class, 1.5 to 3 times as costly as the optimum."""
MEASURED = f"""\
Three questions to every optimiser among the planners.

*Known optima*: `improve` from a long detour of the right class, on the problems of `optima`; J is integrated in steps
{FINER} times as fine as those that were optimised with, the worst seed is shown. The targets are for the smooth
problems ({", ".join(SMOOTH)}); `disc` has an obstacle and `two_media` a jump of the density. "None": nothing better.

*Bundled tasks*: RRT-Connect with its shortcuts, until these find nothing more, then `improve` of that same path for
the same time by every optimiser, w = 1. A path counts only if it is free at the finest step. "{MORE_SHORTCUTS}" are
what the same time brings if the shortcuts go on, for comparison.

*Gradients*: against central differences of fourth order. The clearance is compared with that of a twin in double
precision, separately where surroundings and where the robot itself are nearest, within {gradients.CLEAR:g} m; the error
is relative to the norm of the gradient. "Kinks" were left out: the slopes ahead and behind differ.
"""


@dataclass(frozen=True, kw_only=True)
class Improvement:
    """What an optimiser made of a path."""

    total: float
    seconds: float
    iterations: int
    refused: int = 0
    """Paths that were not free at the finest step, or not better."""


@dataclass(frozen=True, kw_only=True)
class Improvements:
    """What came of one task."""

    task: str
    before: float = np.inf
    improved: dict[str, Improvement] = field(default_factory=dict)


def optimisers() -> dict[str, type[Planner]]:
    """Every optimiser among the planners, by name."""
    return {name: kind for name, kind in gp.PLANNERS.items() if issubclass(kind, Optimiser)}


def run(options: suite.Options) -> str:
    """BestMotion the three questions."""
    seeds, points = options.pick((3, 100), quick=(1, 20))
    analytic_seconds, path_seconds, seconds = options.pick((2.0, 5.0, 1.0), quick=(0.5, 0.5, 0.2))
    seconds = options.seconds or seconds
    ratios = {name: _ratios(name, seeds, analytic_seconds) for name in optimisers()}
    tasks = suite.task_names(options)
    jobs = [(task, seed, path_seconds, seconds) for task in tasks for seed in range(seeds)]
    findings = list(suite.spread(examine, jobs, options.processes, "optimisers"))
    findings.sort(key=lambda finding: tasks.index(finding.task))
    slopes = [*gradients.analytic(points)]
    for name in {task.split("/")[0]: task for task in reversed(tasks)}.values():
        slopes += gradients.examine(name, points)
    header = ("optimiser", *analytic_problems())
    return "\n".join(
        [
            MEASURED,
            report.targets([*_targets(ratios, findings), *_gradient_targets(slopes)]),
            f"### J / J* after {analytic_seconds:g} s, the worst of {seeds} seeds\n",
            report.table(
                header, [(name, *(_number(values[p]) for p in header[1:])) for name, values in ratios.items()]
            ),
            f"### After {seconds:g} s from the same path, {seeds} seeds of RRT-Connect\n",
            _summary(findings),
            "### J, relative to that of the path it began with, median\n",
            _by_task(findings, tasks),
            "### Gradients\n",
            _gradient_table(slopes),
        ]
    )


def _ratios(name: str, seeds: int, seconds: float) -> dict[str, float]:
    """Worst J / J* of an optimiser on each problem; infinite if it finds nothing better than where it begins."""
    worst = dict.fromkeys(analytic_problems(), 0.0)
    for problem, instance in analytic_problems().items():
        for seed in range(seeds):
            begin, budget = gp.Path(BEGIN[problem]), Budget(seconds)
            found = [*_improve(name)(begin, instance.problem, instance.objective, budget, np.random.default_rng(seed))]
            exact = replace(instance.objective, step=instance.objective.step / FINER)
            total = path_total(exact, found[-1]) if found else np.inf
            worst[problem] = max(worst[problem], total / instance.optimum)
    return worst


def _improve(name: str) -> Callable[..., Iterator[gp.Path]]:
    if name == MORE_SHORTCUTS:
        return _more_shortcuts
    planner = optimisers()[name]()
    assert isinstance(planner, Optimiser)
    return planner.improve


def _more_shortcuts(
    path: gp.Path, problem: SceneProblem, objective: SceneObjective, budget: Budget, rng: np.random.Generator
) -> Iterator[gp.Path]:
    yield from Shortcut(patience=1_000_000).improve(path, InterruptibleProblem(problem, objective, budget), budget, rng)


def examine(job: tuple[str, int, float, float]) -> Improvements:
    """Give every optimiser the same path of one task and the same time.

    Args:
        job: Task, seed, seconds for the path to begin with, seconds of every optimiser.
    """
    name, seed, path_seconds, seconds = job
    task = suite.task(name)
    planning.warm("auto", name)
    problem = problem_of(task, MARGIN)
    objective = gp.Objective(w=planning.W).bind(task.scene)
    if problem is None:
        return Improvements(task=name)
    rng = np.random.default_rng(seed)
    paths = list(gp.RRTConnect().solve(problem, objective, Budget(path_seconds), rng))
    path = next((path for path in reversed(paths) if is_solution(path, problem)), None)
    if path is None:
        return Improvements(task=name)
    improved = {}
    for optimiser in (*optimisers(), MORE_SHORTCUTS):
        if optimiser in optimisers():
            planning.warm(optimiser)
        work = _improve(optimiser)(path, problem, objective, budget := Budget(seconds), np.random.default_rng(seed))
        improved[optimiser] = _best_of(work, path, problem, objective, budget)
    return Improvements(task=name, before=path_total(objective, path), improved=improved)


def _best_of(
    work: Iterator[gp.Path], path: gp.Path, problem: SceneProblem, objective: SceneObjective, budget: Budget
) -> Improvement:
    """Let an optimiser work until its budget is spent, and return what was the best of it."""
    best, refused = path_total(objective, path), 0
    for found in work:
        total = path_total(objective, found)
        if is_solution(found, problem) and total < best:
            best = total
        else:
            refused += 1
    return Improvement(total=best, seconds=budget.elapsed, iterations=budget.spent, refused=refused)


def _gains(findings: list[Improvements], name: str) -> Array:
    """J after over J before; 1 where nothing better was found."""
    return np.array([f.improved[name].total / f.before if name in f.improved else 1.0 for f in findings])


def _lowered(findings: list[Improvements], name: str) -> Array:
    return _gains(findings, name) < 1.0


def _targets(ratios: dict[str, dict[str, float]], findings: list[Improvements]) -> Iterator[report.Target]:
    for name, values in ratios.items():
        within, problem = WITHIN.get(name, WITHIN_ELSE), max(SMOOTH, key=lambda problem: values[problem])
        yield report.Target(
            what=f"{name}, worst of the smooth problems",
            wanted=f"J / J* <= {1.0 + within:g}",
            measured=f"{_number(values[problem])} ({problem})",
            met=values[problem] <= 1.0 + within,
        )
    for name in ratios:
        share = float(_lowered(findings, name).mean())
        yield report.Target(
            what=f"{name}, runs in which it lowers J",
            wanted=f">= {report.percent(SHARE_LOWERED, 0)}",
            measured=f"{report.percent(share)} of {len(findings)}",
            met=share >= SHARE_LOWERED,
        )


def _gradient_targets(slopes: list[gradients.SlopeCheck]) -> Iterator[report.Target]:
    for term in dict.fromkeys(finding.term for finding in slopes):
        worst = max((f for f in slopes if f.term == term), key=lambda f: f.worst)
        yield report.Target(
            what=f"gradient of {term}, largest error",
            wanted=f"<= {GRADIENT_ERROR:g}",
            measured=f"{worst.worst:.1e} ({worst.where})",
            met=worst.worst <= GRADIENT_ERROR,
        )


def _summary(findings: list[Improvements]) -> str:
    rows = []
    for name in (*optimisers(), MORE_SHORTCUTS):
        gains = _gains(findings, name)
        mine = [f.improved[name] for f in findings if name in f.improved]
        iterations = np.array([i.iterations for i in mine])
        each = np.median([1e3 * i.seconds / i.iterations for i in mine if i.iterations] or [np.inf])
        cells = (f"{np.median(gains):.4f}", f"{np.mean(gains):.4f}", f"{gains.min():.3f}")
        refused = sum(i.refused for i in mine)
        lowered = report.percent(float(_lowered(findings, name).mean()))
        spent = f"{np.median(iterations):.0f}" if len(mine) else "none"
        rows.append((name, lowered, *cells, report.quantity(float(each)), spent, refused))
    header = ("optimiser", "lowered J", "median", "mean", "best", "ms an iteration", "iterations", "refused")
    return report.table(header, rows)


def _by_task(findings: list[Improvements], tasks: list[str]) -> str:
    names = (*optimisers(), MORE_SHORTCUTS)
    rows = []
    for task in tasks:
        mine = [finding for finding in findings if finding.task == task]
        before = report.quantity(float(np.median([finding.before for finding in mine])), digits=4)
        rows.append((task, before, *(f"{np.median(_gains(mine, name)):.4f}" for name in names)))
    return report.table(("task", "J before", *names), rows)


def _gradient_table(slopes: list[gradients.SlopeCheck]) -> str:
    rows = [(f.term, f.where, f.count, f"{f.worst:.1e}", f.kinks) for f in slopes]
    return report.table(("term", "where", "points", "largest error", "kinks"), rows)


def _number(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else "none"

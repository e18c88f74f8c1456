"""Every planner on small problems whose least total cost is known exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from graceful_plan.compare.problems.analytic import AnalyticProblem, analytic_problems, disc, two_media
from graceful_plan.planners.planner import Budget, path_total

TITLE = "Optima: J / J* on problems with a known optimum"
FINER = 50
WITHIN = 0.02
"""What asymptotically optimal planners have to reach in two dimensions."""
MEASURED = f"""\
The planners' own `solve`, on two-dimensional problems with an exactly known least cost J* (straight lines, a taut
string around a disc, Snell's refraction, a geodesic of the hyperbolic half-plane, a catenary) and, for the record,
two of them in seven dimensions. J is integrated in steps {FINER} times as fine as those that were planned with. The
worst seed is shown; "none": no path. Planners that stop at their first path, shortcut as they do by default, are not
held to the target.
"""


HIGH_DIMENSION = {"disc, 7-D": disc, "two_media, 7-D": two_media}


def run(options: suite.Options) -> str:
    """Run every planner on every problem."""
    seeds, seconds = options.pick((2, 4.0), quick=(1, 0.3))
    seconds = options.seconds or seconds
    names = [*analytic_problems(), *HIGH_DIMENSION]
    jobs = [(planner, name, seed, seconds) for name in names for planner in gp.PLANNERS for seed in range(seeds)]
    worst: dict[tuple[str, str], float] = {}
    for planner, name, ratio in suite.spread(solve, jobs, options.processes, "optima"):
        key = (planner, name)
        worst[key] = max(ratio, worst.get(key, 0.0))
    rows = [(planner, *(_ratio(worst[planner, name]) for name in names)) for planner in gp.PLANNERS]
    budget = f"{seconds:g} s a run or until a planner ends by itself, {seeds} seeds."
    return f"{MEASURED}\n{budget}\n\n{report.targets(_targets(worst))}\n{report.table(('planner', *names), rows)}"


def solve(job: tuple[str, str, int, float]) -> tuple[str, str, float]:
    """Return J / J* of the last path that a planner yields on a problem; infinite if there is none."""
    planner, problem, seed, seconds = job
    planning.warm(planner)
    instance = _instance(problem)
    budget, rng = Budget(seconds), np.random.default_rng(seed)
    paths = [None, *gp.PLANNERS[planner]().solve(instance.problem, instance.objective, budget, rng)]
    exact = replace(instance.objective, step=instance.objective.step / FINER)
    total = path_total(exact, paths[-1]) if paths[-1] is not None else np.inf
    return planner, problem, total / instance.optimum


def _instance(name: str) -> AnalyticProblem:
    return HIGH_DIMENSION[name](7) if name in HIGH_DIMENSION else analytic_problems()[name]


def _ratio(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else "none"


def _targets(worst: dict[tuple[str, str], float]) -> Iterator[report.Target]:
    for planner, kind in gp.PLANNERS.items():
        if not kind.anytime:
            continue
        problem = max(analytic_problems(), key=lambda name: worst[planner, name])
        ratio = worst[planner, problem]
        yield report.Target(
            what=f"{planner}, worst of the two-dimensional problems",
            wanted=f"<= {1.0 + WITHIN:g}",
            measured=f"{_ratio(ratio)} ({problem})",
            met=ratio <= 1.0 + WITHIN,
        )

"""Invented or quick comparisons, for tests of the comparison tool."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from graceful_plan.compare import Comparison, Run
from graceful_plan.result import TracePoint

MACHINE = {
    "processor": "abacus",
    "cores": "2",
    "memory": "4 GB",
    "system": "Linux",
    "kernels": "none",
    "versions": "graceful_plan 0, Python 3",
}

PLANNER_FILE = '''
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan import Path, Planner


@dataclass(frozen=True, kw_only=True)
class Straight(Planner):
    """Goes straight, if that is free."""

    name: ClassVar[str] = "straight"
    anytime: ClassVar[bool] = False

    pieces: int = 1

    def solve(self, problem, objective, budget, rng):
        budget.spend()
        ACT
        q = np.linspace(problem.start, problem.goals[0], self.pieces + 1)
        if problem.edges_free(q[:-1], q[1:]).all():
            yield Path(q)
'''


def own_planner(folder: Path, act: str = "pass", name: str = "straight") -> str:
    """Write a module with a planner that first runs some code, then returns the straight line; return its name.

    The folder must be the current directory, or on the module path.
    """
    (folder / f"{name}.py").write_text(PLANNER_FILE.replace("ACT", act).replace('"straight"', f'"{name}"'))
    return f"{name}:Straight"


def suite_file(folder: Path, problems: str = "free_space, uniform_density") -> Path:
    """Write a suite of problems in the plane."""
    file = folder / "plane.yaml"
    file.write_text(f"version: 1\nseconds: 0.3\nseeds: 2\nproblems: [{{analytic: [{problems}]}}]\n")
    return file


def solved(problem: str, planner: str, seed: int, total: float, first: float = 0.01) -> Run:
    """Return an invented run whose first path cost twice as much."""
    trace = tuple(
        TracePoint(time=time, total=cost, motion=0.75 * cost, impact=0.25 * cost)
        for time, cost in ((first, 2.0 * total), (10.0 * first, total))
    )
    return Run(
        problem=problem,
        planner=planner,
        seed=seed,
        status="SOLVED",
        seconds=0.4,
        first=first,
        total=total,
        motion=0.75 * total,
        impact=0.25 * total,
        jerk_peak=100.0,
        jerk_rms=10.0,
        duration=1.5,
        length=0.75 * total,
        clearance=0.02,
        self_clearance=0.03,
        certified=0.01,
        iterations=12.0,
        trace=trace,
        path=((0.0, 0.0), (1.0, 1.0)),
        times=(0.0, 1.5),
        velocities=((0.0, 0.0), (0.0, 0.0)),
    )


def comparison(runs: Iterable[Run], planners: Sequence[str], problems: Sequence[str], seeds: int = 1) -> Comparison:
    """Return a comparison of runs."""
    return Comparison(
        suite="made up",
        problems=tuple(problems),
        planners=tuple(planners),
        seeds=tuple(range(seeds)),
        seconds=0.5,
        w=1.0,
        machine=MACHINE,
        begun="2020-01-01 00:00:00+00:00",
        runs=tuple(runs),
        settings={
            "processes": 1,
            "planners": [{"label": name, "name": name, "settings": {"range": 0.4}} for name in planners],
        },
    )


PROBLEMS = tuple(f"room/{i}" for i in range(7))


def rich(planners: Sequence[str] = ("first", "second <&>", "third")) -> Comparison:
    """Return a comparison in which the second planner's paths cost 10 % more and the third one often fails."""
    runs = []
    for i, problem in enumerate(PROBLEMS):
        for seed in range(2):
            for k, planner in enumerate(planners):
                if k == 2 and (i + seed) % 2:
                    status = "RAISED" if seed else "TIMEOUT"
                    runs.append(
                        Run(problem=problem, planner=planner, seed=seed, status=status, detail="<broken & bad>")
                    )
                else:
                    total = (1.0 + i) * (1.0 + 0.1 * k) * (1.0 + 0.001 * seed)
                    runs.append(solved(problem, planner, seed, total, first=0.001 * (1 + k)))
    return comparison(runs, planners, PROBLEMS, seeds=2)


def all_failed() -> Comparison:
    """Return a comparison in which nothing was solved."""
    runs = [
        Run(problem=problem, planner=planner, seed=0, status=status, detail="no luck", seconds=math.nan)
        for problem in ("a", "b")
        for planner, status in (("x", "TIMEOUT"), ("y", "CRASHED"))
    ]
    return comparison(runs, ("x", "y"), ("a", "b"))

"""A cost of one's own: the same one as a block of the core, in Python with its gradient, and in Python without."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.motion_problems import KINDS, make
from graceful_plan.compare.problems.problem_files import ProblemFile

Array = np.ndarray

TITLE = "Own costs: clearance as a block, in Python, and in Python without a gradient"
SEED = 7
DISTANCE, WEIGHT = 0.05, 2.0
LIMITS = (0.1, 0.2, 0.3, 0.45, 0.6, 0.9, 1.2)
"""Time limits of a call [s]."""
WANTED = {0.3: 5.8, 1.2: 5.4}
"""Mean J of the block that is wanted by a time [s]; the bar is for problems of MotionBenchMaker itself."""
SOONER = 2.0
"""How many times sooner than without a gradient an equal J is to be reached."""
CLOSE = 1.005
"""Factor on the J to be reached."""
BLOCK, STATE_FEATURES, UNTOLD, SHORTEST = "block", "Python, with gradient", "Python, without gradient", "least length"
COSTS = (BLOCK, STATE_FEATURES, UNTOLD)
MEASURED = f"""\
J = length + {WEIGHT:g} x the integral of max(0, 1 - clearance / 5 cm) over length, clearance that of the spheres to all
that stands around, without self-clearance; a mean over problems. The problems are our own of the seven kinds of
MotionBenchMaker, as in `motion_problems`, so that figures do not compare with those of its own files. "{BLOCK}" is
`gp.ClearanceCost({DISTANCE:g})`. "{STATE_FEATURES}" is an object of one's own that answers with the numbers of that block, so
that the cost is the same and only who is asked differs: `state` and `gradient` are called with batches, from within the
descents. "{UNTOLD}" has `state` alone. Each entry is `gp.plan(objective=..., time_limit=...)` with one seed a problem,
whole calls to verified motions, evaluated by `gp.evaluate`; means are over problems that were solved in every one of
these runs. "{SHORTEST}" is `gp.plan(w=0)` in the longest time, which knows nothing of clearance. Time to
equal J is the least of these limits at which the mean is within {CLOSE - 1:.1%} of what "{UNTOLD}" has at the longest.
Seeds: J of 6 seeds at .3 s on the first problem of each kind, its standard deviation relative to its mean.
"""


@dataclass(frozen=True)
class InPython(gp.Cost):
    """A cost that planners know nothing of but its numbers."""

    told: bool
    held: gp.Cost

    def state(self, batch: gp.StateBatch) -> Array:
        """Return the cost density."""
        return self.held.state(batch)

    def gradient(self, batch: gp.StateBatch) -> Array | None:
        """Return its derivative, if that is told."""
        return self.held.gradient(batch) if self.told else None


_NEAR = gp.ClearanceCost(DISTANCE)
MADE: dict[str, gp.Cost] = {BLOCK: _NEAR, STATE_FEATURES: InPython(True, _NEAR), UNTOLD: InPython(False, _NEAR)}


def run(options: suite.Options) -> str:
    """Plan on problems of every kind, in one process."""
    limits = options.pick(LIMITS, quick=(0.1, 0.3))
    seeds = options.pick(6, quick=2)
    firsts = [make(kind, options.pick(2, quick=1), SEED) for kind in KINDS]
    problems = [problem for kind in firsts for problem in kind]
    totals = {
        (cost, limit): np.array([_total(problem, cost, limit) for problem in problems])
        for limit in limits
        for cost in COSTS
    }
    everywhere = np.isfinite(np.stack(list(totals.values()))).all(axis=0)
    shortest = np.array([_total(problem, SHORTEST, limits[-1]) for problem in problems])
    spread = {
        cost: np.mean([_spread([_total(kind[0], cost, 0.3, seed) for seed in range(seeds)]) for kind in firsts])
        for cost in COSTS
    }
    means = {key: float(total[everywhere].mean()) for key, total in totals.items()}
    rows = list(_rows(totals, means, limits, spread))
    header = ["cost", *(f"J at {limit:g} s" for limit in limits), "time to equal J", "solved", "spread over seeds"]
    counted = f"{len(problems)} problems, seed {SEED}; {everywhere.sum()} solved in every run."
    targets = report.targets(_targets(means, limits))
    return (
        f"{MEASURED}\n{counted}\n\n{targets}\n{report.table(header, rows)}\n\n"
        f"Shortest motions have J = {np.nanmean(shortest[everywhere]):.3f} at {limits[-1]:g} s."
    )


def _targets(means: dict[tuple[str, float], float], limits: tuple[float, ...]) -> Iterator[report.Target]:
    for limit, most in WANTED.items():
        if limit in limits:
            mean = means[BLOCK, limit]
            what = f"J of the block at {limit:g} s"
            yield report.Target(what=what, wanted=f"<= {most:g}", measured=f"{mean:.3f}", met=mean <= most)
    slow = _time_to_equal(UNTOLD, means, limits)
    for cost in (BLOCK, STATE_FEATURES):
        ratio = slow / _time_to_equal(cost, means, limits)
        what = f'{cost}: equal J sooner than "{UNTOLD}" by'
        yield report.Target(what=what, wanted=f">= {SOONER:g} x", measured=f"{ratio:.1f} x", met=ratio >= SOONER)


def _time_to_equal(cost: str, means: dict[tuple[str, float], float], limits: tuple[float, ...]) -> float:
    """Return the least limit at which the mean is close to that without a gradient at the longest; infinite if none."""
    goal = CLOSE * means[UNTOLD, limits[-1]]
    return next((limit for limit in limits if means[cost, limit] <= goal), np.inf)


def _rows(
    totals: dict[tuple[str, float], Array],
    means: dict[tuple[str, float], float],
    limits: tuple[float, ...],
    spread: dict[str, float],
) -> Iterator[list[object]]:
    for cost in COSTS:
        reached = _time_to_equal(cost, means, limits)
        solved = sum(int(np.isfinite(totals[cost, limit]).sum()) for limit in limits)
        runs = sum(len(totals[cost, limit]) for limit in limits)
        time = f"{reached:g} s" if np.isfinite(reached) else f"more than {limits[-1]:g} s"
        yield [
            cost,
            *(f"{means[cost, limit]:.3f}" for limit in limits),
            time,
            f"{solved} of {runs}",
            report.percent(spread[cost]),
        ]


def _total(problem: ProblemFile, cost: str, limit: float, seed: int = 0) -> float:
    """Return J of what is planned, NaN if nothing is."""
    charged = gp.Objective(impact=MADE[BLOCK], w=WEIGHT, exposure="length")
    given = (
        charged.with_weight(0.0) if cost == SHORTEST else gp.Objective(impact=MADE[cost], w=WEIGHT, exposure="length")
    )
    scene = problem.scene
    found = gp.plan(problem.start, problem.goals, scene, objective=given, time_limit=limit, seed=seed)
    solved = found.status is gp.PlanStatus.SOLVED and found.trajectory is not None
    return gp.evaluate(found.trajectory, scene, charged).total if solved else np.nan


def _spread(totals: list[float]) -> float:
    return float(np.nanstd(totals) / np.nanmean(totals))

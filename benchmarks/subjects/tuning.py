"""Front of `gp.pareto`, compared with a sweep of the planner over weights in ten times the time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from graceful_plan.planners.roadmaps.graph import non_dominated
from graceful_plan.tuning.points import dominated_area
from graceful_plan.tuning.search import sweep_weights

Array = np.ndarray

TITLE = "Tuning: a front in ten seconds"
QUESTION = "Is the front that `gp.pareto` finds in 10 s as good as a sweep of the planner in ten times the time?"
HEADLINE = "hypervolume"
DEPENDS_ON = (*suite.PLANNING, "src/graceful_plan/tuning")
PICTURE = Path(__file__).parents[2] / "docs" / "images" / "tuning_fronts.png"
SCENE = "tabletop"
SECONDS_BELOW = 10.0
POINTS_AT_LEAST = 12
WEIGHTS = 20
"""Number of weights of the sweep: 0 and a geometric series."""
TIMES = 10.0
"""Duration of the sweep over the duration of the front."""
MEASURED = """\
`gp.pareto` with its defaults on tasks of `tabletop`: whole calls, scenes loaded and compiled before, every point
verified. The sweep calls `gp.plan` with the default planner at {weights} safety weights (0 and a geometric series over
the range that `pareto` sweeps), in {times:g} times the time in all. "Hypervolume": share of the rectangle between zero
and the reference that the front dominates. The reference is 1.1 times the largest motion and the largest impact of all
fronts of the task. "Epsilon": least factor on the costs of the other front (for the sweep: of seed 0) at which this one
is as good everywhere. "By a weight": points with the least V + w S of their front for some w.
"""


@dataclass(frozen=True, kw_only=True)
class MeasuredFront:
    """Motion and impact of verified motions, and the time to find them."""

    costs: Array
    seconds: float
    by_weight: int = 0
    status: str = "SOLVED"


@dataclass(frozen=True, kw_only=True)
class TaskFronts:
    """Result for one task."""

    task: str
    tuned: tuple[MeasuredFront, ...]
    swept: MeasuredFront

    @property
    def reference(self) -> Array:
        """Reference of all hypervolumes of the task."""
        return 1.1 * np.concatenate([self.swept.costs, *(front.costs for front in self.tuned)]).max(axis=0)

    def hypervolume(self, front: MeasuredFront) -> float:
        """Return the share of the rectangle between zero and the reference that the front dominates."""
        return dominated_area(front.costs, self.reference) / float(np.prod(self.reference))


def run(options: suite.Options) -> str:
    """Find fronts and sweep; write the picture unless this is a quick run."""
    tasks, seeds, seconds, weights = options.pick(
        (2, 2, SECONDS_BELOW, WEIGHTS), quick=(1, 1, 2.0, 5), long=(4, 3, SECONDS_BELOW, WEIGHTS)
    )
    names = [name for name in suite.task_names() if name.startswith(f"{SCENE}/")][:tasks]
    # One process: both have limits in seconds.
    findings = list(suite.spread(lambda name: examine(name, seeds, seconds, weights), names, 1, "tuning"))
    if not options.quick:
        draw(findings, PICTURE)
    header = ("task", "front of", "seconds", "points", "by a weight", "hypervolume", "of the sweep's", "epsilon")
    rows = [row for finding in findings for row in _rows(finding)]
    introduction = MEASURED.format(weights=weights, times=TIMES)
    picture = "" if options.quick else f"\n![Fronts and sweeps](../../docs/images/{PICTURE.name})\n"
    return f"{introduction}\n{report.targets(_targets(findings))}\n{report.table(header, rows)}{picture}"


def examine(name: str, seeds: int, seconds: float, weights: int) -> TaskFronts:
    """Find the front of a task with several seeds, and sweep."""
    planning.warm("auto", name)
    tuned = tuple(tune(name, seed, seconds) for seed in range(seeds))
    return TaskFronts(task=name, tuned=tuned, swept=sweep(name, weights, TIMES * seconds))


def tune(name: str, seed: int, seconds: float) -> MeasuredFront:
    """Call `gp.pareto`."""
    task = suite.task(name)
    started = time.perf_counter()
    front = gp.pareto(task.start, task.goal, task.scene, time_limit=seconds, seed=seed)
    seconds = time.perf_counter() - started
    by_weight = sum(point.weights is not None for point in front.points)
    return MeasuredFront(costs=front.costs, seconds=seconds, by_weight=by_weight, status=front.status.name)


def sweep(name: str, count: int, seconds: float) -> MeasuredFront:
    """Call `gp.plan` at each weight and keep the non-dominated motions."""
    task = suite.task(name)
    started = time.perf_counter()

    def cost(w: float) -> gp.CostBreakdown | None:
        result = gp.plan(task.start, task.goal, task.scene, w=w, time_limit=seconds / count)
        return result.cost if result.status is gp.PlanStatus.SOLVED else None

    shortest = cost(0.0)
    if shortest is None:
        return MeasuredFront(costs=np.zeros((0, 2)), seconds=time.perf_counter() - started, status="NOT SOLVED")
    weights = sweep_weights(np.array([shortest.motion, shortest.impact]), count - 1)
    found = [shortest, *(cost(w) for w in weights.tolist())]
    costs = np.array([(c.motion, c.impact) for c in found if c is not None])
    costs = costs[non_dominated(costs)]
    return MeasuredFront(costs=costs, seconds=time.perf_counter() - started, by_weight=len(costs))


def epsilon(front: Array, other: Array) -> float:
    """Return the least factor on the other front at which this one is as good everywhere."""
    if not len(front) or not len(other):
        return np.inf
    ratio = np.divide(front[:, None], other[None], out=np.ones((len(front), len(other), 2)), where=other[None] > 0.0)
    return float(ratio.max(axis=2).min(axis=0).max())


def _rows(finding: TaskFronts) -> Iterator[tuple[object, ...]]:
    base = finding.hypervolume(finding.swept)
    for label, front, other in [
        *((f"`pareto`, seed {seed}", front, finding.swept) for seed, front in enumerate(finding.tuned)),
        ("sweep", finding.swept, finding.tuned[0]),
    ]:
        volume = finding.hypervolume(front)
        yield (
            finding.task,
            label,
            report.quantity(front.seconds),
            len(front.costs),
            front.by_weight,
            f"{volume:.4f}",
            report.percent(volume / base, 2) if base else "none",
            f"{epsilon(front.costs, other.costs):.3f}",
        )


def _targets(findings: Sequence[TaskFronts]) -> Iterator[report.Target]:
    every = [front for finding in findings for front in finding.tuned]
    slowest, fewest = max(front.seconds for front in every), min(len(front.costs) for front in every)
    yield report.Target(
        what="time of a front, slowest",
        wanted=f"< {SECONDS_BELOW:g} s",
        measured=f"{slowest:.2f} s",
        met=slowest < SECONDS_BELOW,
    )
    yield report.Target(
        what="points that no other is better than, fewest",
        wanted=f">= {POINTS_AT_LEAST}",
        measured=str(fewest),
        met=fewest >= POINTS_AT_LEAST,
    )
    ratios = [f.hypervolume(front) / f.hypervolume(f.swept) for f in findings for front in f.tuned]
    yield report.Target(
        what=f"hypervolume relative to a sweep in {TIMES:g} times the time, worst seed and task",
        wanted=">= 100 %",
        measured=report.percent(min(ratios), 2),
        met=min(ratios) >= 1.0,
    )


def draw(findings: Sequence[TaskFronts], file: Path) -> None:
    """Draw the fronts beside the sweeps."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.1 * len(findings), 3.2), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    for place, finding in enumerate(findings):
        axes: Any = figure.add_subplot(1, len(findings), place + 1)
        for seed, front in enumerate(finding.tuned):
            label = "pareto" if seed == 0 else None
            axes.step(*front.costs.T, where="post", color="#0b62c4", linewidth=0.9, alpha=0.8, label=label)
        axes.plot(*finding.swept.costs.T, "x", color="#d55e00", markersize=5, label="sweep")
        if min(front.costs[:, 1].min() for front in (*finding.tuned, finding.swept)) > 0.0:
            axes.set_yscale("log")
        axes.set_title(finding.task.split("/")[1], fontsize=9)
        axes.set(xlabel="motion V [rad]", ylabel="impact S" if place == 0 else "")
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(file)

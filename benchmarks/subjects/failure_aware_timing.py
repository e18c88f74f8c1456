"""Does timing that knows about failures do less harm? The same paths, timed plainly and failure-aware, in FailBench."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import failbench
import graceful_plan as gp
from benchmarks import report, suite
from failbench.calibrations import skill
from graceful_plan.array_types import Float
from graceful_plan.query.finish import DEVIATIONS
from graceful_plan.timing.failure_aware import ImpactOfStates, timed_cost

TITLE = "Failure-aware timing: harm of the same failures on the same paths"
MEASURED = """\
Paths of each task, planned with w = 0 and with w = 1 and the drop model (anytime planner, {iterations} iterations),
each timed twice: plainly, as fast as the limits allow, and failure-aware, as by `speed="failure_aware"` at w = 1. Then
{fault} along both, {n} rollouts each with common random numbers; the onset is uniform over the duration. "Per failure":
mean observed impact. "In all": times the duration, which is what a constant rate of failures adds up to. F = T + w T I
with the observed impact and, in brackets, with the predicted one that the timing minimises. The difference per failure
is plain minus failure-aware, with a paired interval (95 %). "Limits": the share of the velocity limits that both
timings may use, the highest of {speeds} at which the simulated robot keeps up with the plain motion and its grasp
holds. Paths for which there is none are refused.
"""
DISTRIBUTION = """\
The distribution of the impact of a failure along the plain motions, by `gp.risk` and as observed, predicted first.
CVaR 0.9 is the mean of the worst tenth of failures. Over {n} motions: Spearman's correlation of expected impacts
{expected:.3f}, of CVaR {cvar:.3f}; sums of predictions over sums of observations {expected_ratio:.2f} and
{cvar_ratio:.2f}.
"""
FAULT = "drop/gripper_failure/critical"
WEIGHTS = (0.0, 1.0)
SPEEDS = (1.0, 0.7, 0.5)
LEVEL = 0.9
AT = 1.0
"""Safety weight of the timing."""


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How much."""

    rollouts: int
    iterations: int


FULL = Sizes(rollouts=400, iterations=20_000)
QUICK = Sizes(rollouts=40, iterations=2_000)


class Distribution(NamedTuple):
    """What is told of a distribution of impact."""

    expected: float
    cvar: float
    no_harm: float


@dataclass(frozen=True, kw_only=True)
class Case:
    """A path, timed in two ways; the first of each pair is the plain timing."""

    task: str
    w: float
    refused: str = ""
    speed: float = math.nan
    duration: tuple[float, float] = (math.nan, math.nan)
    observed: tuple[float, float] = (math.nan, math.nan)
    predicted: tuple[float, float] = (math.nan, math.nan)
    difference: failbench.Estimate | None = None
    """Plain minus failure-aware, per failure."""
    risk: Distribution | None = None
    """Predicted along the plain motion."""
    outcome: Distribution | None = None
    """Observed."""

    def total(self, which: int, predicted: bool = False) -> float:
        """F [s]."""
        impact = (self.predicted if predicted else self.observed)[which]
        return self.duration[which] * (1.0 + AT * impact)


def run(options: suite.Options) -> str:
    """Time and validate the paths of all tasks, and return Markdown."""
    sizes = QUICK if options.quick else FULL
    jobs = [(name, w, sizes) for name in suite.task_names(options) for w in WEIGHTS]
    cases = sorted(suite.spread(measure, jobs, options.processes, "timing"), key=lambda case: (case.task, case.w))
    told = MEASURED.format(
        iterations=sizes.iterations, fault=FAULT, n=sizes.rollouts, speeds=", ".join(f"{x:g}" for x in SPEEDS)
    )
    done = [case for case in cases if not case.refused]
    tables = [report.targets(_targets(done)), report.table(_HEADER, _rows(cases))]
    return "\n".join([told, *tables, _distributions(done)])


def measure(job: tuple[str, float, Sizes]) -> Case:
    """Plan a path, time it in both ways and let the gripper fail along both."""
    name, w, sizes = job
    task = suite.task(name)
    impact = gp.ImpactCost(model="footprint")
    objective = gp.Objective(impact=impact, w=w)
    found = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=sizes.iterations)
    if found.path is None:
        return Case(task=name, w=w, refused=found.status.name)
    states = objective.bind(task.scene).states
    refused = ""
    for speed in SPEEDS:
        plain, aware = timings(found.path, task.scene, states, speed)
        try:
            reports = [
                failbench.validate(motion, task.scene, FAULT, n=sizes.rollouts, threads=1, prediction=impact)
                for motion in (plain, aware)
            ]
            break
        except failbench.ExecutionRefused as error:
            refused = error.what
    else:
        return Case(task=name, w=w, refused=refused)
    risk = gp.risk(plain, task.scene, impact, level=LEVEL)
    return Case(
        task=name,
        w=w,
        speed=speed,
        risk=Distribution(risk.expected, risk.cvar, risk.no_harm),
        outcome=_observed(reports[0].impacts),
        duration=(plain.duration, aware.duration),
        observed=(reports[0].observed.mean, reports[1].observed.mean),
        predicted=(_mean_impact(plain, states), _mean_impact(aware, states)),
        difference=failbench.compare(reports[0], reports[1]),
    )


def _observed(impacts: Float[np.ndarray, " n"]) -> Distribution:
    worst_first = np.sort(impacts[np.isfinite(impacts)])[::-1]
    tail = max(1, round((1.0 - LEVEL) * len(worst_first)))
    return Distribution(float(worst_first.mean()), float(worst_first[:tail].mean()), float(np.mean(worst_first == 0.0)))


def timings(
    path: gp.Path, scene: gp.Scene, states: ImpactOfStates, speed: float
) -> tuple[gp.Trajectory, gp.Trajectory]:
    """Time a path plainly and failure-aware, cutting its corners as far as that stays free of collisions."""

    def plainly(deviation: float) -> gp.Trajectory:
        return gp.retime(path, scene.limits, scene.joints, deviation=deviation, speed=speed)

    clear = (deviation for deviation in DEVIATIONS if gp.verify(plainly(deviation), scene).passed)
    deviation = next(clear, DEVIATIONS[-1])
    return plainly(deviation), gp.retime(
        path, scene.limits, scene.joints, deviation=deviation, speed=speed, impact=states, w=AT
    )


def _mean_impact(trajectory: gp.Trajectory, states: ImpactOfStates) -> float:
    return timed_cost(trajectory, states, 1.0) / trajectory.duration - 1.0


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = ("task", "path", "limits", "duration [s]", "", "per failure", "", "difference", "in all [s]", "", "F [s]", "")


def _targets(cases: Sequence[Case]) -> Iterator[report.Target]:
    for w in WEIGHTS:
        mine = [case for case in cases if case.w == w]
        changed = [case for case in mine if case.duration[0] != case.duration[1]]
        worse = [case.task for case in mine if case.difference is not None and case.difference.high < 0.0]
        told = (
            "none"
            if not changed
            else (
                f"{sum(case.total(1) <= case.total(0) for case in changed)} of {len(changed)}; sums "
                f"{_sum(case.total(0) for case in changed)} to {_sum(case.total(1) for case in changed)}"
            )
        )
        yield report.Target(
            what=f"paths of w = {w:g}: F with the observed impact falls where the timing changes, in sum",
            wanted="less",
            measured=told,
            met=sum(case.total(1) for case in changed) < sum(case.total(0) for case in changed) if changed else None,
        )
        yield report.Target(
            what=f"paths of w = {w:g}: tasks with more harm per failure beyond the interval",
            wanted="0",
            measured=f"{len(worse)} of {len(mine)} {', '.join(worse)}",
            met=not worse if mine else None,
        )


def _rows(cases: Sequence[Case]) -> Iterator[Sequence[object]]:
    for case in cases:
        if case.refused:
            yield (case.task, f"w = {case.w:g}", f"refused: {case.refused}", *[""] * 9)
            continue
        exposure = [t * impact for t, impact in zip(case.duration, case.observed, strict=True)]
        yield (
            case.task,
            f"w = {case.w:g}",
            f"{case.speed:g}",
            *(f"{t:.2f}" for t in case.duration),
            *(f"{impact:.2f} ({model:.2f})" for impact, model in zip(case.observed, case.predicted, strict=True)),
            str(case.difference),
            *(f"{x:.2f}" for x in exposure),
            *(f"{case.total(k):.2f} ({case.total(k, predicted=True):.2f})" for k in (0, 1)),
        )
    for w in WEIGHTS:
        mine = [case for case in cases if case.w == w and not case.refused]
        if not mine:
            continue
        yield (
            f"all {len(mine)}, sums",
            f"w = {w:g}",
            "",
            *(_sum(case.duration[k] for case in mine) for k in (0, 1)),
            *(_sum(case.observed[k] for case in mine) for k in (0, 1)),
            "",
            *(_sum(case.duration[k] * case.observed[k] for case in mine) for k in (0, 1)),
            *(_sum(case.total(k) for case in mine) for k in (0, 1)),
        )


def _distributions(cases: Sequence[Case]) -> str:
    pairs = [(case, case.risk, case.outcome) for case in cases if case.risk is not None and case.outcome is not None]
    if len(pairs) < 3:
        return ""
    predicted, observed = (np.array([pair[k] for pair in pairs]) for k in (1, 2))
    ratios = predicted.sum(axis=0) / observed.sum(axis=0)
    told = DISTRIBUTION.format(
        n=len(pairs),
        expected=skill.spearman(predicted[:, 0], observed[:, 0]),
        cvar=skill.spearman(predicted[:, 1], observed[:, 1]),
        expected_ratio=ratios[0],
        cvar_ratio=ratios[1],
    )
    header = ("task", "path", "expected", "", "CVaR 0.9", "", "no harm", "")
    rows = [
        (
            case.task,
            f"w = {case.w:g}",
            *(f"{x:.2f}" for x in (risk.expected, outcome.expected, risk.cvar, outcome.cvar)),
            *(report.percent(x) for x in (risk.no_harm, outcome.no_harm)),
        )
        for case, risk, outcome in pairs
    ]
    return told + "\n" + report.table(header, rows)


def _sum(values: Iterable[float]) -> str:
    return f"{sum(values):.1f}"

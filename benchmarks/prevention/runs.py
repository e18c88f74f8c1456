"""Motions planned with different costs, and the harm of failures along them; one line of JSON per job.

A "headline" job plans a task at w = 0 and at the default w of the impact models; their harm is paired with that at
w = 0. A "curve" job plans a task over a grid of weights of one cost, with the grasp of the headline.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import suite
from benchmarks.prevention import common_sense
from benchmarks.store import read_lines
from failbench import Estimate, ExecutionRefused, SimSettings, ValidationReport
from failbench.calibrations.failures import DROP
from failbench.fault.fault import Fault
from failbench.report import FAILURES_PER_HOUR
from failbench.validation import chosen_faults

SEED = 77
SPEED = 0.5
"""Fraction of the velocity limits of all motions."""
SECONDS, OWN_SECONDS = 1.0, 5.0
"""Time limit of a plan with a native cost, and with a cost in Python [s]."""
NONE, PUBLISHED, OURS, ALL_FAULTS, ENERGY = "w = 0", "Algorithm 1", "default", "service robot", "by energy"
MODELS: Mapping[str, gp.ImpactCost] = MappingProxyType(
    {
        PUBLISHED: gp.ImpactCost(model="box_overlap"),
        OURS: gp.ImpactCost(),
        ALL_FAULTS: gp.ImpactCost(model=gp.FailureMixture(faults="service_robot")),
        ENERGY: gp.ImpactCost(consequence="energy"),
    }
)
"""Impact models of the headline, at the default w; their weights are absolute."""
CURVES = (OURS, PUBLISHED, *common_sense.COSTS)
"""Costs of the curves."""


@dataclass(frozen=True, kw_only=True)
class Harm:
    """Harm of one kind of failures along a motion.

    Args:
        mean: Observed impact of a failure.
        n: Number of failures.
        own: The part of the mean that is the loss of the carried object itself.
        energy: The mean with each contact weighted by the probability of damage at its energy.
        by_fault: Mean impact by fault, "NAME/DEGREE".
        predicted: Impact of a failure as the default model predicts it.
        less_per_failure: Harm per failure at w = 0 over that of the motion, with its interval; None at w = 0 and for
            unpaired failures.
        less_per_task: The same ratio per executed task.
        rise: Harm per executed task minus that at w = 0, with its interval.
    """

    mean: float
    n: int
    predicted: float
    own: float = 0.0
    energy: float = 0.0
    by_fault: Mapping[str, float] = field(default_factory=dict)
    less_per_failure: tuple[float, float, float] | None = None
    less_per_task: tuple[float, float, float] | None = None
    rise: tuple[float, float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A planned motion.

    Args:
        w: Weight of the plan.
        refused: Reason why there is no motion or the healthy robot cannot execute it; otherwise "".
        length: Joint-space length [rad].
        duration: [s].
        kept: Share of the contents at the end of the healthy motion; 1 without contents.
        healthy: Harm of the healthy motion.
        harm: By kind of failures, "drops" or "mixed".
    """

    w: float
    refused: str = ""
    length: float = float("nan")
    duration: float = float("nan")
    kept: float = 1.0
    healthy: float = 0.0
    harm: Mapping[str, Harm] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Headline:
    """A task with a motion of each model.

    Args:
        task: "scene/task".
        grasp: "fingers" or "weld".
        least: Least positive severity of the scene.
        rate: Failures per hour.
        motions: By label, those of `NONE` and `MODELS`.
    """

    task: str
    grasp: str
    least: float
    rate: float
    motions: Mapping[str, Motion]


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A task and a cost over its weights.

    Args:
        task: "scene/task".
        cost: One of `CURVES`.
        points: Motions by weight, absolute for impact models, otherwise relative; see `weight_of`.
    """

    task: str
    cost: str
    points: Mapping[str, Motion]


@dataclass(frozen=True, kw_only=True)
class HeadlineJob:
    """Labels of the motions of a task, and numbers of failures along each; no mixed failures if zero."""

    task: str = ""
    drops: int
    mixed: int
    labels: tuple[str, ...] = (NONE, *MODELS)


@dataclass(frozen=True, kw_only=True)
class CurveJob:
    """Weights of a cost in a task, grasp, and number of drops along each motion."""

    task: str
    cost: str
    weights: tuple[float, ...]
    grasp: str
    drops: int


# --- jobs -----------------------------------------------------------------------------------------------------------


def do_headline(job: HeadlineJob) -> Headline:
    """Plan at w = 0 and with each impact model at the default w, and simulate the same failures along all motions."""
    task = suite.task(job.task)
    objectives = {NONE: gp.Objective(w=0.0), **{label: gp.Objective(impact=x) for label, x in MODELS.items()}}
    objectives = {label: objectives[label] for label in job.labels}
    results = {label: _planned(task, objective, SECONDS) for label, objective in objectives.items()}
    grasp, refused = _held(job.task, results)
    counts = {"drops": job.drops, **({"mixed": job.mixed} if job.mixed else {})}
    reference: dict[str, ValidationReport] | None = None
    motions: dict[str, Motion] = {}
    for label, result in results.items():
        reports = {} if refused[label] else _reports(task, result, counts, grasp)
        paired = {} if reference is None else reference
        harm = {kind: _harm(own, paired.get(kind)) for kind, own in reports.items()}
        motion = _motion(result, objectives[label].w, refused[label], harm)
        motions[label] = replace(motion, **_without_failure(reports))
        reference = reports if label == NONE else reference
    rate = FAILURES_PER_HOUR
    return Headline(task=job.task, grasp=grasp, least=least_severity(task.scene), rate=rate, motions=motions)


def do_curve(job: CurveJob) -> Curve:
    """Plan with a cost at each weight, and drop the object along each motion."""
    task = suite.task(job.task)
    own = common_sense.COSTS.get(job.cost)
    impact = MODELS[job.cost] if own is None else own(task.scene)
    points: dict[str, Motion] = {}
    for asked in job.weights:
        w = asked if own is None else weight_of(asked, task, impact)
        result = _planned(task, gp.Objective(impact=impact, w=w), SECONDS if own is None else OWN_SECONDS)
        refused = _refusal(task, result, job.grasp)
        reports = {} if refused else _reports(task, result, {"drops": job.drops}, job.grasp)
        harm = {kind: _harm(found, None) for kind, found in reports.items()}
        points[f"{asked:g}"] = replace(_motion(result, w, refused, harm), **_without_failure(reports))
    return Curve(task=job.task, cost=job.cost, points=points)


def weight_of(relative: float, task: gp.Task, impact: gp.Cost) -> float:
    """Return the weight at which the impact of the straight path to the first goal is a multiple of its motion.

    Own costs have different units; this makes their weights comparable over costs and tasks.
    """
    straight = gp.evaluate(np.stack([task.start, task.goal[0]]), task.scene, gp.Objective(impact=impact, w=1.0))
    return relative * straight.motion / straight.impact if straight.impact > 0.0 else relative


def kinds(task: gp.Task) -> dict[str, Sequence[Fault]]:
    """Return the faults of each kind of failures."""
    drop = {} if task.object_name is None else {"drops": DROP}
    return {**drop, "mixed": chosen_faults("*/*/severe")}


# --- parts of jobs --------------------------------------------------------------------------------------------------


def _planned(task: gp.Task, objective: gp.Objective, seconds: float) -> gp.PlanResult:
    return gp.plan(task.start, task.goal, task.scene, objective=objective, time_limit=seconds, seed=SEED, speed=SPEED)


def _held(name: str, results: Mapping[str, gp.PlanResult]) -> tuple[str, dict[str, str]]:
    """Return the grasp, a weld if fingers lose the object along any motion, and the reasons of refused motions."""
    task, refused = suite.task(name), dict[str, str]()
    grasp = "weld"
    for grasp in ("fingers", "weld"):
        refused = {label: _refusal(task, result, grasp) for label, result in results.items()}
        if not any(refused[label] for label, result in results.items() if result.trajectory is not None):
            break
    return grasp, refused


def _refusal(task: gp.Task, result: gp.PlanResult, grasp: str) -> str:
    """Return the reason why a motion cannot be executed; otherwise ""."""
    if result.trajectory is None:
        return f"{result.status.name}: {result.detail}"
    try:
        fb.execute(result, fb.build_world(task.scene, SimSettings(grasp=grasp)))
    except ExecutionRefused as error:
        return str(error)
    return ""


def _without_failure(reports: Mapping[str, ValidationReport]) -> dict[str, float]:
    """Return the fields of a motion about its healthy execution, which is the same in all reports."""
    for found in reports.values():
        return {"kept": 1.0 - found.healthy.spilled, "healthy": found.healthy.harm}
    return {}


def _reports(
    task: gp.Task, result: gp.PlanResult, counts: Mapping[str, int], grasp: str
) -> dict[str, ValidationReport]:
    settings = SimSettings(grasp=grasp)
    return {
        kind: fb.validate(result, task.scene, faults, n=counts[kind], seed=SEED, threads=1, settings=settings)
        for kind, faults in kinds(task).items()
        if kind in counts
    }


def _harm(own: ValidationReport, reference: ValidationReport | None) -> Harm:
    """Summarise failures, paired with those at w = 0 if given."""
    plain = Harm(
        mean=own.observed.mean,
        n=own.observed.n,
        predicted=own.predicted,
        own=own.own_loss.mean,
        energy=own.energy.mean,
        by_fault={label: found.mean for label, found in own.by_fault.items()},
    )
    if reference is None:
        return plain
    return Harm(
        **asdict(plain)
        | {
            "less_per_failure": _triple(fb.harm_ratio(reference, own, per="failure")),
            "less_per_task": _triple(fb.harm_ratio(reference, own)),
            "rise": _triple(fb.compare(own, reference, per="task")),
        }
    )


def _triple(estimate: Estimate) -> tuple[float, float, float]:
    return estimate.mean, estimate.low, estimate.high


def _motion(result: gp.PlanResult, w: float, refused: str, harm: Mapping[str, Harm]) -> Motion:
    if result.trajectory is None or result.path is None:
        return Motion(w=w, refused=refused)
    length = float(np.linalg.norm(np.diff(result.trajectory.q, axis=0), axis=1).sum())
    return Motion(w=w, refused=refused, length=length, duration=result.trajectory.duration, harm=harm)


def least_severity(scene: gp.Scene) -> float:
    """Return the least positive severity of a scene."""
    return min(s for entity in scene.entities.values() for s in entity.severity.values() if s > 0.0)


# --- stored lines --------------------------------------------------------------------------------------------------


def read_headlines(file: Path) -> Iterator[Headline]:
    """Yield the finished headlines."""
    for x in read_lines(file):
        yield Headline(**{**x, "motions": _motions(x["motions"])})


def read_curves(file: Path) -> Iterator[Curve]:
    """Yield the finished curves, with all points of a task and cost together."""
    found: dict[tuple[str, str], dict[str, Motion]] = {}
    for x in read_lines(file):
        found.setdefault((x["task"], x["cost"]), {}).update(_motions(x["points"]))
    for (task, cost), points in found.items():
        yield Curve(task=task, cost=cost, points=dict(sorted(points.items(), key=lambda item: float(item[0]))))


def _motions(kept: Mapping[str, Any]) -> dict[str, Motion]:
    return {
        key: Motion(**{**x, "harm": {kind: Harm(**_tuples(y)) for kind, y in x["harm"].items()}})
        for key, x in kept.items()
    }


def _tuples(x: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in x.items()}

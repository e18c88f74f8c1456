"""Harm of all 19 faults along transports of LIBERO; one line of JSON per task, and their tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import report
from benchmarks.libero.runs import NONE, OURS, SEED, SPEED, held_by
from benchmarks.libero.scenes import NoTransport, transport
from benchmarks.prevention.harm_curves import floored, typical
from benchmarks.prevention.runs import least_severity
from benchmarks.store import read_lines
from failbench.validation import chosen_faults

ALL_FAULTS = "service robot"
OBJECTIVES: Mapping[str, gp.Objective] = MappingProxyType(
    {
        NONE: gp.Objective(w=0.0),
        OURS: gp.Objective(impact=gp.ImpactCost(consequence="contact")),
        ALL_FAULTS: gp.Objective(
            impact=gp.ImpactCost(model=gp.FailureMixture(faults="service_robot"), consequence="contact")
        ),
    }
)
"""Objective of each motion, by label."""


@dataclass(frozen=True, kw_only=True)
class MixedMotion:
    """Harm of mixed faults along a motion.

    Args:
        duration: [s].
        healthy: Harm of the healthy robot.
        mean: Observed impact of a failure, with its interval.
        own: The part of it that is the loss of the carried object itself.
        by_fault: Observed impact by fault, "NAME/DEGREE".
        less: Harm per task at w = 0 over that of the motion, from paired failures; NaN if neither does harm.
    """

    duration: float
    healthy: float
    mean: Sequence[float]
    own: float
    by_fault: Mapping[str, float]
    less: Sequence[float]


@dataclass(frozen=True, kw_only=True)
class Mixed:
    """A task with its motions by label; none if it was refused."""

    task: str
    refused: str = ""
    grasp: str = ""
    least: float = float("nan")
    n: int = 0
    motions: Mapping[str, MixedMotion] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class MixedJob:
    """An exported task, and the number of failures along each motion."""

    folder: str
    mixed: int


def do_mixed(job: MixedJob) -> Mixed:
    """Plan a task with each objective, and simulate the same failures along all motions."""
    name = Path(job.folder).name
    try:
        carry = transport(Path(job.folder))
    except (NoTransport, gp.GracefulPlanError) as error:
        return Mixed(task=name, refused=f"{type(error).__name__}: {error}")
    results = {
        label: gp.plan(carry.start, carry.goal, carry.scene, objective=objective, seed=SEED, speed=SPEED)
        for label, objective in OBJECTIVES.items()
    }
    grasp, held = held_by(carry, results)
    for label, found in held.items():
        if isinstance(found, str):
            return Mixed(task=name, refused=f"{label}: {found}")
    settings, faults = fb.SimSettings(grasp=grasp, control="torque"), chosen_faults("*/*/severe")
    reports = {
        label: fb.validate(result, carry.scene, faults, n=job.mixed, seed=SEED, threads=1, settings=settings)
        for label, result in results.items()
    }
    least = least_severity(carry.scene)
    motions = {label: _motion(found, reports[NONE]) for label, found in reports.items()}
    return Mixed(task=name, grasp=grasp, least=least, n=reports[NONE].n, motions=motions)


def _motion(found: fb.ValidationReport, base: fb.ValidationReport) -> MixedMotion:
    return MixedMotion(
        duration=found.duration,
        healthy=found.healthy.harm,
        mean=_triple(found.observed),
        own=found.own_loss.mean,
        by_fault={label: x.mean for label, x in found.by_fault.items()},
        less=_triple(fb.harm_ratio(base, found)),
    )


def _triple(x: fb.Estimate) -> list[float]:
    return [x.mean, x.low, x.high]


def read_mixed(file: Path) -> Iterator[Mixed]:
    """Yield the finished tasks."""
    for line in read_lines(file):
        line["motions"] = {label: MixedMotion(**x) for label, x in line["motions"].items()}
        yield Mixed(**line)


# --- tables -----------------------------------------------------------------------------------------------------------


def mixed_sections(done: Sequence[Mixed]) -> Iterator[str]:
    """Yield the section on mixed faults."""
    heads = [x for x in done if not x.refused]
    if not heads:
        return
    harmed = sum(motion.healthy > 0.0 for x in heads for motion in x.motions.values())
    yield (
        f"## All 19 faults\n\nEach of the 19 faults, severe, equally often, at the same fractions of each motion:"
        f" {heads[0].n} failures a motion in the first {len(heads)} tasks with a transport. Fingers hold the object by"
        f" friction in {sum(x.grasp == 'fingers' for x in heads)} of them, a weld in the others. Harm counts every"
        f" contact in full. The healthy robot does harm along {harmed} of {len(heads) * len(OBJECTIVES)} motions."
        f' "{ALL_FAULTS}": the default model with that prior of faults instead of drops only.\n'
    )
    for x in done:
        if x.refused:
            yield f"Not measured: {x.task} ({x.refused}).\n"
    yield report.table(
        ("motion", "harm of a failure", "own loss in it", "duration", "x less per task", "in sum", "worse", "better"),
        [_row(heads, label) for label in OBJECTIVES],
    )
    yield "Harm of a failure by fault, mean over the tasks:\n"
    yield report.table(("fault", *OBJECTIVES), _fault_rows(heads))
    yield "Harm of a failure by task, and harm per task at w = 0 over that of the motion:\n"
    yield report.table(
        ("task", "grasp", *(f"harm, {label}" for label in OBJECTIVES), *(f"x less, {x}" for x in _OTHERS)),
        [_task_row(x) for x in heads],
    )


_OTHERS = tuple(label for label in OBJECTIVES if label != NONE)


def _row(heads: Sequence[Mixed], label: str) -> tuple[object, ...]:
    motions, base = [x.motions[label] for x in heads], [x.motions[NONE] for x in heads]
    mean, own = np.mean([m.mean[0] for m in motions]), np.mean([m.own for m in motions])
    longer = float(np.median([m.duration / b.duration for m, b in zip(motions, base, strict=True)])) - 1.0
    if label == NONE:
        return (label, f"{mean:.2f}", f"{own:.2g}", "-", "-", "-", "-", "-")
    per_task = [[floored(x.motions[k].mean[0], x.n, x.least) * x.motions[k].duration for k in (NONE, label)]
                for x in heads]  # fmt: skip
    less = typical([a / b for a, b in per_task]).geometric
    return (
        label,
        f"{mean:.2f}",
        f"{own:.2g}",
        f"{report.percent(longer)} more",
        interval((less.mean, less.low, less.high)),
        interval(_summed(np.array(per_task))),
        sum(m.less[2] < 1.0 for m in motions),
        sum(m.less[1] > 1.0 for m in motions),
    )


def _summed(pairs: np.ndarray) -> tuple[float, float, float]:
    rows = np.random.default_rng(0).integers(len(pairs), size=(1000, len(pairs)))
    sums = pairs[rows].sum(axis=1)
    low, high = np.quantile(sums[:, 0] / sums[:, 1], [0.025, 0.975])
    return float(pairs[:, 0].sum() / pairs[:, 1].sum()), float(low), float(high)


def _fault_rows(heads: Sequence[Mixed]) -> Iterator[tuple[object, ...]]:
    for fault in heads[0].motions[NONE].by_fault:
        means = [np.mean([x.motions[label].by_fault[fault] for x in heads]) for label in OBJECTIVES]
        yield (fault.partition("/")[0], *(f"{mean:.2f}" for mean in means))


def _task_row(x: Mixed) -> tuple[object, ...]:
    harms = ["{:.2f} [{:.2f}, {:.2f}]".format(*x.motions[label].mean) for label in OBJECTIVES]
    return (x.task, x.grasp, *harms, *(interval(x.motions[label].less) for label in _OTHERS))


def interval(x: Sequence[float]) -> str:
    """Format an estimate with its interval; "-" without one."""
    return "-" if np.isnan(x[0]) else "{:.2f} [{:.2f}, {:.2f}]".format(*x)

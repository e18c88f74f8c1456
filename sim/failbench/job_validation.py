"""Validation of whole jobs: failures at any moment of a sequence of steps, and their harm per executed job.

A failure during a job strikes in one of its motions. Each motion is executed in its own scene, in which everything is
where the steps before have put it. It gets rollouts in proportion to its duration, so failures are uniform over the
time of the job. Errors of one motion are not carried over to the next: each starts where the plan says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from failbench.basics.statistics import Estimate
from failbench.fault.fault import Fault
from failbench.report import FAILURES_PER_HOUR, ValidationReport
from failbench.validation import chosen_faults, strikes, validate
from graceful_plan.exceptions import SettingError
from graceful_plan.job.job_result import JobMotion, JobResult

_BAR = 20
"""Width of the bar that stands for all harm [characters]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ValidatedMotion:
    """A motion of a job with the failures along it; `step` is the index of its step."""

    step: int
    label: str
    report: ValidationReport


@dataclass(frozen=True, kw_only=True, eq=False)
class JobValidation:
    """Observed harm of failures during a whole job. Made by `validate_job`.

    | field    | meaning                                                                                     |
    |----------|---------------------------------------------------------------------------------------------|
    | observed | expected harm per executed job, with the interval of a sum of independent estimates         |
    | by_step  | part of each step                                                                           |
    | steps    | kind and object of each step                                                                |
    | starts   | time at which each step starts [s]                                                          |
    | motions  | reports of all motions along which these faults can do harm                                 |
    | duration | duration of the whole job [s]                                                               |
    """

    observed: Estimate
    by_step: tuple[Estimate, ...]
    steps: tuple[str, ...]
    starts: tuple[float, ...]
    motions: tuple[ValidatedMotion, ...]
    duration: float

    @property
    def predicted_by_step(self) -> tuple[float, ...]:
        """Predicted part of each step in the expected harm of failures per executed job."""
        return tuple(
            sum((one.report.predicted_per_task for one in self.motions if one.step == k), 0.0)
            for k in range(len(self.steps))
        )

    @property
    def by_entity(self) -> Mapping[str, Estimate]:
        """Part of each entity in the harm of failures per executed job, without harm before a failure."""
        parts: dict[str, list[Estimate]] = {}
        for one in self.motions:
            for name, entity in one.report.by_entity.items():
                parts.setdefault(name, []).append(entity.impact.scaled(one.report.failures_per_task))
        return {name: _sum(some) for name, some in parts.items()}

    def to_document(self) -> dict[str, Any]:
        """Return the validation as a document of plain values, for `graceful_plan.viz.job_page`."""
        return {
            "observed": asdict(self.observed),
            "by_step": [asdict(part) for part in self.by_step],
            "predicted_by_step": list(self.predicted_by_step),
            "by_entity": {name: asdict(part) for name, part in self.by_entity.items()},
            "duration": self.duration,
        }

    def __str__(self) -> str:
        """Return the timeline: start, name and harm of each step, with a bar for its share of the harm."""
        whole, width = self.observed.mean, max(map(len, self.steps))
        shares = [step.mean / whole if whole > 0.0 else 0.0 for step in self.by_step]
        lines = [
            f"{start:6.1f} s  {name:{width}}  {'#' * round(_BAR * share):{_BAR}} {100.0 * share:3.0f} %  {step}"
            for start, name, share, step in zip(self.starts, self.steps, shares, self.by_step, strict=True)
        ]
        return "\n".join([f"harm per executed job of {self.duration:.1f} s: {self.observed}", *lines])


def validate_job(
    result: JobResult,
    scenarios: str | Fault | Sequence[str | Fault] = "drop/*/severe",
    *,
    n: int = 400,
    seed: int = 0,
    threads: int | None = None,
    rate: float = FAILURES_PER_HOUR,
    confidence: float = 0.95,
) -> JobValidation:
    """Simulate failures at any moment of a job, and return the harm per executed job.

    Args:
        result: A solved job.
        scenarios: Faults, as in `validate`. Faults of the gripper strike only while it holds an object.
        n: Number of rollouts over the whole job; each motion gets at least one per fault.
        seed: Seed of all random numbers.
        threads: As in `validate`.
        rate: Failures per hour, of all these faults together.
        confidence: Confidence level of the intervals.

    Raises:
        JobFailed: If the job is not solved.
        ExecutionRefused: If the healthy robot cannot execute a motion, or loses the object.
        SettingError: If no motion is exposed to these faults.
    """
    steps, faults = result.unwrap(), chosen_faults(scenarios)
    exposed = [
        (k, motion, struck)
        for k, step in enumerate(steps)
        for motion in step.pieces
        if motion.trajectory.duration > 0.0 and (struck := [f for f in faults if strikes(f, motion.scene)])
    ]
    if not exposed:
        raise SettingError("scenarios", scenarios, "faults that strike a motion of the job")
    time = sum(motion.trajectory.duration for _, motion, _ in exposed)

    def report(motion: JobMotion, struck: Sequence[Fault]) -> ValidationReport:
        share = math.ceil(n * motion.trajectory.duration / time)
        one = validate(
            motion.trajectory,
            motion.scene,
            struck,
            n=share,
            seed=seed,
            threads=threads,
            rate=rate,
            confidence=confidence,
        )
        # Of all faults at this rate, only those that strike here do harm here.
        return replace(one, rate=rate * len(struck) / len(faults))

    found = tuple(
        ValidatedMotion(step=k, label=motion.label, report=report(motion, some)) for k, motion, some in exposed
    )
    by_step = tuple(_sum([one.report.observed_per_task for one in found if one.step == k]) for k in range(len(steps)))
    return JobValidation(
        observed=_sum(by_step),
        by_step=by_step,
        steps=tuple(f"{step.kind} {step.name}" for step in steps),
        starts=tuple(sum((step.duration for step in steps[:k]), 0.0) for k in range(len(steps))),
        motions=found,
        duration=result.duration,
    )


def _sum(parts: Sequence[Estimate]) -> Estimate:
    """Return the sum of independent estimates; distances to the ends of the intervals add in squares."""
    mean = sum(part.mean for part in parts)
    below, above = (
        math.sqrt(sum((end(part) - part.mean) ** 2 for part in parts))
        for end in (lambda part: part.low, lambda part: part.high)
    )
    return Estimate(mean, mean - below, mean + above, sum(part.n for part in parts))

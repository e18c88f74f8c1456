"""Comparison of the harm of two motions: differences and ratios with common random numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from failbench.basics.statistics import Estimate, estimate_difference, estimate_ratio
from failbench.report import FAILURES_PER_HOUR, ValidationReport
from failbench.simulated.world import SimSettings
from failbench.validation import Motion, Progress, Scenarios, validate
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError

PER = ("failure", "task")
"""Reference of harm: one failure, or one executed task with the expected number of failures during it."""


def compare(
    first: Motion | ValidationReport,
    second: Motion | ValidationReport,
    scene: Scene | None = None,
    scenarios: Scenarios = "drop/*/severe",
    *,
    per: str = "failure",
    n: int = 400,
    horizon: float = 1.0,
    seed: int = 0,
    threads: int | None = None,
    settings: SimSettings | None = None,
    rate: float = FAILURES_PER_HOUR,
    confidence: float = 0.95,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the harm of the first motion minus that of the second.

    Each failure of one motion is paired with the failure of the other that has the same fault, quantile of the onset
    and random numbers, which reduces the variance. Motions are validated first; for reports, only `per` and
    `confidence` are used.

    Args:
        first: A motion, as for `validate`, or a report of `validate`.
        second: Another motion or report.
        scene: The scene; not needed for reports.
        scenarios: Faults, as for `validate`.
        per: "failure", or "task" for harm per executed task: longer motions have more failures, and harm of the healthy
            robot counts with probability 1.
        n: Number of failures.
        horizon: Simulated time after the onset [s].
        seed: Seed of all random numbers.
        threads: Number of simulation threads.
        settings: Settings of the simulation.
        rate: Failures per hour of motion.
        confidence: Confidence level of the interval.
        progress: Called with the numbers of finished and of all rollouts, for each motion.

    Raises:
        SettingError: If the failures of two reports differ, or, per task, their failure rates.
    """

    def validated(motion: Motion | ValidationReport) -> ValidationReport:
        if isinstance(motion, ValidationReport):
            return motion
        return validate(
            motion,
            _needed(scene),
            scenarios,
            n=n,
            horizon=horizon,
            seed=seed,
            threads=threads,
            settings=settings,
            rate=rate,
            confidence=confidence,
            progress=progress,
        )

    pairs = _paired(validated(first), validated(second), per)
    failures = estimate_difference(
        pairs.first, pairs.second, (0.0, pairs.greatest), weights=pairs.weights, confidence=confidence
    )
    return failures.shifted(pairs.certain[0] - pairs.certain[1])


def harm_ratio(
    first: ValidationReport, second: ValidationReport, *, per: str = "task", confidence: float = 0.95
) -> Estimate:
    """Estimate the harm of the first motion divided by that of the second; see `compare`.

    Args:
        first: Report of the motion in the numerator.
        second: Report of the motion in the denominator.
        per: "task" or "failure".
        confidence: Confidence level of the interval.

    Returns:
        The ratio; infinite if only the second does no harm, NaN if neither does.

    Raises:
        SettingError: If the failures of the two reports differ, or, per task, their failure rates.
    """
    pairs = _paired(first, second, per)
    return estimate_ratio(
        pairs.first,
        pairs.second,
        (0.0, pairs.greatest),
        weights=pairs.weights,
        certain=pairs.certain,
        confidence=confidence,
    )


class _Pairs(NamedTuple):
    """Harm of paired failures with common random numbers."""

    first: Float[Array, " n"]
    second: Float[Array, " n"]
    weights: Float[Array, " n"]
    greatest: float
    """Greatest harm that one failure can be expected to do."""
    certain: tuple[float, float]
    """Harm without a failure of the first and the second motion, per task; 0 per failure."""


def _paired(first: ValidationReport, second: ValidationReport, per: str) -> _Pairs:
    if per not in PER:
        raise SettingError("per", per, "'failure' or 'task'")
    reports = (first, second)
    failures = [[(job.fault, job.seed, job.weight, report.horizon) for job in report.jobs] for report in reports]
    if failures[0] != failures[1]:
        raise SettingError("second", second.seed, "the same faults, n, seed and horizon, and no importance sampling")
    if per == "task" and first.rate != second.rate:
        raise SettingError("second", second.rate, f"the rate of the first, {first.rate:g} failures per hour")
    scales = [report.failures_per_task if per == "task" else 1.0 for report in reports]
    observed = [report.wholes if per == "task" else report.impacts for report in reports]
    harms = [scale * impacts for scale, impacts in zip(scales, observed, strict=True)]
    paired = ~np.isnan(first.impacts + second.impacts)
    greatest = max(scale * report.greatest for scale, report in zip(scales, reports, strict=True))
    weights = np.array([job.weight for job in first.jobs])[paired]
    first_certain, second_certain = (report.certain_per_task if per == "task" else 0.0 for report in reports)
    return _Pairs(harms[0][paired], harms[1][paired], weights, greatest, (first_certain, second_certain))


def _needed(scene: Scene | None) -> Scene:
    if scene is None:
        raise SettingError("scene", None, "the scene of the motions")
    return scene

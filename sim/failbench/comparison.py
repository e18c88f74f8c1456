"""How much more harm does one motion do than another? Differences and ratios under common random numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from failbench.basics.statistics import Estimate, estimate_difference, estimate_ratio
from failbench.report import FAILURES_PER_HOUR, ValidationReport
from failbench.simulated.world import SimSettings
from failbench.validation import Motion, Progress, Scenarios, validate
from graceful_plan import Scene
from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError

Array = np.ndarray

PER = ("failure", "task")
"""What harm is counted by: a failure, or the executed task with the failures to be expected while it lasts."""


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
    """Estimate by how much more harm the first motion does than the second.

    Every failure of one is paired with the failure of the other that has the same fault, the same quantile of its onset
    and the same random numbers, so that much of their luck cancels. Motions are validated; of reports, only `per` and
    `confidence` still matter.

    Args:
        first: A motion, as for `validate`, or what that returned.
        second: Likewise.
        scene: Where; not needed for reports.
        scenarios: What fails, as of `validate`.
        per: "failure", or "task" for harm per executed task, in which a longer motion has more failures, and what the
            healthy robot does harm to counts with probability 1.
        n: Number of failures.
        horizon: How long is simulated after the onset [s].
        seed: Of everything random.
        threads: Threads of the simulation.
        settings: How it is simulated.
        rate: Failures per hour of motion.
        confidence: Of the interval.
        progress: Called with the number of rollouts done and of all, for each motion.

    Raises:
        SettingError: If the failures of two reports are not the same, or, per task, do not come at the same rate.
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
    """Estimate how many times as much harm the first motion does as the second; see `compare`.

    Args:
        first: Of the motion whose harm is divided.
        second: Of the motion by whose harm it is divided.
        per: "task" or "failure".
        confidence: Of the interval.

    Returns:
        The ratio; infinite if only the second does no harm at all, NaN if neither does.

    Raises:
        SettingError: If the failures of the two are not the same, or, per task, do not come at the same rate.
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
    """Harm of failures that share their random numbers."""

    first: Float[Array, " n"]
    second: Float[Array, " n"]
    weights: Float[Array, " n"]
    greatest: float
    """That one of them can be expected to do."""
    certain: tuple[float, float]
    """Harm per task without any failure, of the first and of the second; 0 per failure."""


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

"""Validation of a Pareto front: observed and predicted impact, point by point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from failbench.basics.errors import ExecutionRefused
from failbench.basics.statistics import Estimate
from failbench.comparison import compare
from failbench.recording.healthy import HealthyHarm
from failbench.report import FAILURES_PER_HOUR, ValidationReport, loudly
from failbench.rollouts.execution import ObjectLost
from failbench.simulated.world import SimSettings
from failbench.validation import Scenarios, validate
from graceful_plan import ParetoFront, Scene, documents
from graceful_plan.exceptions import SettingError

_SCHEMA = {"schema": "failbench.front_validation", "version": 2}


@dataclass(frozen=True, kw_only=True, eq=False)
class PointValidation:
    """Validation of one point of a front.

    Args:
        motion: Motion cost V.
        impact: Impact cost S of the planner: an integral over the length of the path.
        report: Predicted and observed impact per failure; None if the healthy robot cannot execute the motion.
        refused: Reason why it cannot.
        lost: Harm of the healthy robot if it cannot because it loses the object.
    """

    motion: float
    impact: float
    report: ValidationReport | None = None
    refused: str = ""
    lost: HealthyHarm | None = None

    @property
    def healthy(self) -> HealthyHarm | None:
        """Harm of the healthy robot, with probability 1; None if it cannot execute the motion at all."""
        return self.lost if self.report is None else self.report.healthy


@dataclass(frozen=True, kw_only=True, eq=False)
class FrontValidation:
    """Validation of a front. Made by `validate_front`.

    Args:
        scene: Name of the scene.
        points: Points from the shortest motion to that of least impact.
        n: Number of failures along each motion.
        seed: Seed of all random numbers, common to all points.
        rate: Failures per hour of motion.
    """

    scene: str
    points: tuple[PointValidation, ...]
    n: int
    seed: int
    rate: float = FAILURES_PER_HOUR

    @property
    def rank_correlation(self) -> float:
        """Kendall's tau between predicted and observed impact per failure; NaN with fewer than two points."""
        reports = [point.report for point in self.points if point.report is not None]
        if len(reports) < 2:
            return float("nan")
        predicted, observed = (
            np.array(x) for x in zip(*((r.predicted, r.observed.mean) for r in reports), strict=True)
        )
        i, j = np.triu_indices(len(reports), k=1)
        signs = np.sign(predicted[i] - predicted[j]), np.sign(observed[i] - observed[j])
        pairs = [float(np.count_nonzero(sign)) for sign in signs]
        return float(np.sum(signs[0] * signs[1]) / np.sqrt(pairs[0] * pairs[1])) if min(pairs) > 0.0 else float("nan")

    @property
    def against_shortest(self) -> tuple[Estimate | None, ...]:
        """Observed impact per failure of each point minus that of the shortest motion, failure by failure.

        None for motions that cannot be executed, and for all if the shortest one cannot.
        """
        shortest = self.points[0].report
        return tuple(
            None if shortest is None or point.report is None else compare(point.report, shortest)
            for point in self.points
        )

    def to_document(self) -> dict[str, Any]:
        """Return the validation as a document of plain values."""
        points = [
            {
                "motion": point.motion,
                "impact": point.impact,
                "healthy": None if point.healthy is None else point.healthy.to_document(),
                "predicted": None if point.report is None else point.report.predicted,
                "observed": None if point.report is None else asdict(point.report.observed),
                "against_shortest": None if difference is None else asdict(difference),
                "duration": None if point.report is None else point.report.duration,
                "observed_per_task": None if point.report is None else asdict(point.report.observed_per_task),
                "refused": point.refused,
            }
            for point, difference in zip(self.points, self.against_shortest, strict=True)
        ]
        tau = self.rank_correlation
        return {
            **_SCHEMA,
            "scene": self.scene,
            "n": self.n,
            "seed": self.seed,
            "rate": self.rate,
            "kendall_tau": tau,
            "points": points,
        }

    def __str__(self) -> str:
        rows = []
        for point in self.points:
            row: list[object] = [f"{point.motion:.4g}", point.impact]
            row.append("-" if point.healthy is None else point.healthy.harm)
            if point.report is None:
                row += ["-", "refused", point.refused, "-", "-"]
            else:
                seen = point.report.observed
                row += [point.report.predicted, seen.mean, f"[{seen.low:.3g}, {seen.high:.3g}]"]
                row += [f"{point.report.duration:.3g} s", point.report.observed_per_task.mean]
            rows.append(row)
        head = f"{self.scene}: {self.n} failures along each of {len(self.points)} motions, seed {self.seed}; "
        head += f"Kendall's tau of predicted and observed impact {self.rank_correlation:.2f}; {self.rate:g} failures/h"
        columns = ["motion V", "impact S", "without failure", "predicted per failure", "observed", ""]
        columns += ["duration", "observed per task"]
        loud = [
            f"motion V {point.motion:.4g}: {loudly(point.healthy)}\n\n"
            for point in self.points
            if point.healthy is not None and not point.healthy.harmless
        ]
        return f"{''.join(loud)}{head}\n\n{documents.table(columns, rows)}"


def validate_front(
    front: ParetoFront | str | FilePath,
    scene: Scene,
    scenarios: Scenarios = "drop/*/severe",
    *,
    n: int = 200,
    horizon: float = 1.0,
    seed: int = 0,
    threads: int | None = None,
    settings: SimSettings | None = None,
    rate: float = FAILURES_PER_HOUR,
    confidence: float = 0.95,
    progress: Callable[[int, int], None] | None = None,
) -> FrontValidation:
    """Simulate failures along every motion of a front, with common random numbers.

    Args:
        front: The front, or a file written by `ParetoFront.save`.
        scene: The scene with the carried object attached: `task.scene`.
        scenarios: Faults, as for `validate`.
        n: Number of failures along each motion.
        horizon: Simulated time after the onset [s].
        seed: Seed of all random numbers.
        threads: Number of simulation threads.
        settings: Settings of the simulation.
        rate: Failures per hour of motion, for the harm per executed task.
        confidence: Confidence level of the intervals.
        progress: Called with the numbers of finished and of all motions.

    Raises:
        SettingError: If the front is empty, or a setting is out of range.
        FormatError: If the file does not hold a front.
    """
    loaded = front if isinstance(front, ParetoFront) else ParetoFront.load(front)
    if not len(loaded):
        raise SettingError("front", loaded.status.name, "a front with at least one point")
    points = []
    for done, point in enumerate(loaded.points, 1):
        try:
            report = validate(
                point.trajectory,
                scene,
                scenarios,
                n=n,
                horizon=horizon,
                seed=seed,
                threads=threads,
                settings=settings,
                rate=rate,
                confidence=confidence,
            )
            points.append(PointValidation(motion=point.motion, impact=point.impact, report=report))
        except ExecutionRefused as error:
            lost = error.healthy if isinstance(error, ObjectLost) else None
            points.append(PointValidation(motion=point.motion, impact=point.impact, refused=str(error), lost=lost))
        if progress is not None:
            progress(done, len(loaded))
    return FrontValidation(scene=scene.notes.name, points=tuple(points), n=n, seed=seed, rate=rate)

"""Report of a policy's evaluation: figures with intervals, as a table and a JSON document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from failbench.basics.statistics import Estimate
from failbench.policies.rollouts import PolicyRollout

_SECONDS_PER_HOUR = 3600.0
_SCHEMA = {"schema": "failbench.policy", "version": 1}


@dataclass(frozen=True, kw_only=True)
class PolicyFigures:
    """Figures of the episodes of one kind.

    Args:
        success: Probability that the tool reaches its goal in time and still holds its object.
        harm: Sum of the severities of all hits in an episode.
        added: Harm of an episode minus that of the same episode without the fault; None for healthy episodes.
        dropped: Probability that the carried object leaves the gripper.
        spilled: Lost fraction of the contents.
        diverged: Number of episodes that blew up, or whose healthy twin did; no estimate includes them.
    """

    success: Estimate
    harm: Estimate
    added: Estimate | None
    dropped: Estimate
    spilled: Estimate
    diverged: int


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyReport:
    """Success and harm of a policy, healthy and with faults. Made by `evaluate`.

    Args:
        task: "SCENE/TASK".
        healthy: Figures without a failure.
        by_fault: Figures with each fault, by "FAULT/DEGREE".
        duration: Mean time to the goal of the healthy policy [s]; episodes that do not reach it count in full.
        rate: Failures per hour, of all faults together.
        recovery: Recovery after the detection of a fault.
        n: Number of episodes of each kind.
        seed: Seed of all random numbers.
        confidence: Confidence level of the intervals.
        versions: Versions of the packages.
        healthy_rollouts: Episodes without a failure.
        rollouts: Episodes with each fault, in the same order.
    """

    task: str
    healthy: PolicyFigures
    by_fault: Mapping[str, PolicyFigures]
    duration: float
    rate: float
    recovery: str
    n: int
    seed: int
    confidence: float
    versions: Mapping[str, str]
    healthy_rollouts: tuple[PolicyRollout, ...]
    rollouts: Mapping[str, tuple[PolicyRollout, ...]]

    @property
    def harm_per_task(self) -> float:
        """Expected harm per executed task: healthy harm plus that of failures, all faults equally likely."""
        added = [figures.added.mean for figures in self.by_fault.values() if figures.added is not None]
        failures = self.rate * self.duration / _SECONDS_PER_HOUR
        return self.healthy.harm.mean + failures * float(np.mean(added))

    def to_document(self) -> dict[str, Any]:
        """Return the report as plain values, without the episodes."""
        return {
            **_SCHEMA,
            "task": self.task,
            "n": self.n,
            "seed": self.seed,
            "confidence": self.confidence,
            "recovery": self.recovery,
            "duration": self.duration,
            "rate": self.rate,
            "harm_per_task": self.harm_per_task,
            "healthy": asdict(self.healthy),
            "by_fault": {label: asdict(figures) for label, figures in self.by_fault.items()},
            "versions": dict(self.versions),
        }

    def __str__(self) -> str:
        rows = [("healthy", self.healthy), *self.by_fault.items()]
        wide = max(len(label) for label, _ in rows)
        arrived = "at its goal" if all(one.reached for one in self.healthy_rollouts) else "at its goal, or out of time,"
        lines = [
            f"{self.task}: {self.n} episodes of each kind, seed {self.seed}, {100.0 * self.confidence:g} % intervals; "
            f"recovery: {self.recovery}",
            f"{'':{wide}}  {'success':22}  {'harm':22}  {'harm added':22}  dropped  spilled",
            *(_row(label, figures, wide) for label, figures in rows),
            f"healthy robot: {arrived} after {self.duration:.2f} s on average; harm per executed task at "
            f"{self.rate:g} failures/h: {self.harm_per_task:.4g}",
        ]
        diverged = sum(figures.diverged for _, figures in rows)
        return "\n".join([*lines, *([f"{diverged} episodes blew up and do not count"] if diverged else [])])


def _row(label: str, figures: PolicyFigures, wide: int) -> str:
    added = "" if figures.added is None else str(figures.added)
    return (
        f"{label:{wide}}  {figures.success!s:22}  {figures.harm!s:22}  {added:22}  "
        f"{figures.dropped.mean:7.3f}  {figures.spilled.mean:7.3f}"
    )

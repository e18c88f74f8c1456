"""What an evaluation of a policy says: figures with intervals, a table to read, a JSON document."""

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
    """What episodes of one kind came to.

    Args:
        success: Probability that the tool reaches its goal in time, and still holds what it held.
        harm: Sum of the severities of what is hit in an episode.
        added: Harm of the episode minus that of the same one without the fault; None for those without.
        dropped: Probability that the carried object leaves the gripper.
        spilled: Lost part of the contents.
        diverged: Episodes that blew up, or whose healthy twin did; they are in no estimate.
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
        healthy: Without failure.
        by_fault: With each fault, by "FAULT/DEGREE".
        duration: Mean time in which the healthy policy reaches its goal, or the episode's where it does not [s].
        rate: Failures per hour, of all faults together.
        recovery: What takes over once a fault is noticed.
        n: Episodes of each kind.
        seed: Of everything random.
        confidence: Of the intervals.
        versions: Of the packages.
        healthy_rollouts: The episodes without failure.
        rollouts: Those with each fault, in the same order.
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
        """Harm to be expected of an executed task: the healthy robot's, and what failures add, all faults alike."""
        added = [figures.added.mean for figures in self.by_fault.values() if figures.added is not None]
        failures = self.rate * self.duration / _SECONDS_PER_HOUR
        return self.healthy.harm.mean + failures * float(np.mean(added))

    def to_document(self) -> dict[str, Any]:
        """Return it as plain values, without the episodes."""
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
            f"healthy robot: {arrived} after {self.duration:.2f} s in the mean; harm per executed task at "
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

"""Report of a validation: records, a table, and a JSON document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path as FilePath
from typing import Any

from failbench.basics.statistics import Estimate
from failbench.recording.healthy import HealthyHarm
from failbench.recording.records import RolloutRequest
from graceful_plan import documents
from graceful_plan.array_types import Array, Float

FAILURES_PER_HOUR = 1e-3
"""One failure in 1000 h: a round reference for harm per executed task, not a measured rate. If the healthy robot does
no harm, the harm per task is proportional to the rate, and ratios of it do not depend on the rate."""
_SCHEMA = {"schema": "failbench.validation", "version": 3}
_SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True, kw_only=True)
class EntityReport:
    """Effects of failures on one entity.

    Args:
        probability: Probability that a failure makes the robot, the carried object or its contents touch the entity;
            for the carried object itself, that it is damaged.
        impact: The entity's part of the observed impact.
        predicted: The entity's part of the predicted impact.
    """

    probability: Estimate
    impact: Estimate
    predicted: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ValidationReport:
    """Observed and predicted impact of failures along a motion. Made by `validate`.

    Impacts are severities per failure, from its onset on. Spills, losses and touches of the healthy robot have
    probability 1 and are reported separately: `healthy`. Failures occur at a rate per hour, so the expected harm of an
    executed task is the healthy harm plus the impact times the expected number of failures: `observed_per_task`.
    Diverged rollouts are counted, but enter no estimate.

    | field       | meaning                                                                                         |
    |-------------|-------------------------------------------------------------------------------------------------|
    | scene       | name of the scene                                                                               |
    | healthy     | harm of the healthy robot, with probability 1                                                   |
    | observed    | sum over components and entities of the severities of all touches, with `own_loss` if the       |
    |             | prediction includes it                                                                          |
    | whole       | `observed` with the hits before the onset, each pair once; equal to `observed` without such hits |
    | energy      | `observed`, each severity times the damage probability at the energy of the touch               |
    | own_loss    | severity of the loss of the carried object itself, times its damage probability                 |
    | secondary   | impact on entities that only other entities touch                                               |
    | predicted   | mean of the planner's sum of P S over the times of the failures                                 |
    | duration    | duration of the motion [s]                                                                      |
    | rate        | failures per hour of motion                                                                     |
    | by_fault    | observed impact of each fault, by "NAME/DEGREE"                                                 |
    | by_entity   | part of each entity                                                                             |
    | dropped     | fraction of the rollouts in which the carried object left the gripper                           |
    | spilled     | lost fraction of the contents that were there at the onset                                      |
    | diverged    | number of rollouts whose simulation blew up                                                     |
    | n           | number of rollouts, including diverged ones                                                     |
    | effective_n | effective sample size of the weighted rollouts; n without importance sampling                   |
    | seed        | seed of all random numbers                                                                      |
    | horizon     | simulated time after each onset [s]                                                             |
    | confidence  | confidence level of the intervals                                                               |
    | greatest    | severity of the worst possible single touch; guards the intervals                               |
    | versions    | versions of the packages                                                                        |
    | jobs        | specifications of the failures                                                                  |
    | impacts     | observed impact of each failure; NaN if it diverged                                             |
    | wholes      | each failure's impact as in `whole`                                                             |
    """

    scene: str
    healthy: HealthyHarm
    observed: Estimate
    whole: Estimate
    energy: Estimate
    own_loss: Estimate
    secondary: Estimate
    predicted: float
    duration: float
    rate: float
    by_fault: Mapping[str, Estimate]
    by_entity: Mapping[str, EntityReport]
    dropped: Estimate
    spilled: Estimate
    diverged: int
    n: int
    effective_n: float
    seed: int
    horizon: float
    confidence: float
    greatest: float
    versions: Mapping[str, str]
    jobs: tuple[RolloutRequest, ...]
    impacts: Float[Array, " n"]
    wholes: Float[Array, " n"]

    @property
    def failures_per_task(self) -> float:
        """Expected number of failures per execution of the motion."""
        return self.rate * self.duration / _SECONDS_PER_HOUR

    @property
    def certain_per_task(self) -> float:
        """Expected harm of the healthy robot per execution of the motion: its harm if nothing fails."""
        return max(0.0, 1.0 - self.failures_per_task) * self.healthy.harm

    @property
    def observed_per_task(self) -> Estimate:
        """Expected harm per execution of the motion.

        Executions without a failure do the harm of the healthy robot. Executions with one do the harm in `whole`: the
        part before the onset, and the failure's from then on. Nothing counts twice.
        """
        return self.whole.scaled(self.failures_per_task).shifted(self.certain_per_task)

    @property
    def predicted_per_task(self) -> float:
        """Expected predicted impact of failures per execution of the motion."""
        return self.predicted * self.failures_per_task

    def __str__(self) -> str:
        share = f"{100.0 * self.confidence:g} %"
        head = f"{self.scene}: {self.n} failures, {self.horizon:g} s after each, seed {self.seed}"
        head += f"; {self.diverged} diverged and are left out" if self.diverged else ""
        loud = loudly(self.healthy)
        rows = [
            ["observed impact", *_cells(self.observed)],
            ["  weighted by energy", *_cells(self.energy)],
            ["  the object's own loss", *_cells(self.own_loss)],
            ["  secondary", *_cells(self.secondary)],
            ["predicted impact", self.predicted, ""],
            ["dropped", *_cells(self.dropped)],
            ["spilled", *_cells(self.spilled)],
        ]
        tasks = [
            ["observed harm", *_cells(self.observed_per_task)],
            *([["  without any failure", self.certain_per_task, ""]] if loud else []),
            ["predicted harm" + " of failures" * bool(loud), self.predicted_per_task, ""],
        ]
        faults = [[name, *_cells(estimate)] for name, estimate in self.by_fault.items()]
        touched = [item for item in self.by_entity.items() if item[1].probability.mean > 0.0 or item[1].predicted]
        worst = sorted(touched, key=lambda item: -max(item[1].impact.mean, item[1].predicted))
        entities = [[name, *_cells(e.probability), *_cells(e.impact), e.predicted] for name, e in worst]
        tables = [
            documents.table(["per failure", "mean", share], rows),
            documents.table([f"per task of {self.duration:.3g} s at {self.rate:g} failures/h", "mean", share], tasks),
            documents.table(["fault", "observed impact", share], faults),
        ]
        if entities:
            columns = ["entity", "touched", share, "impact", share, "predicted"]
            tables.append(documents.table(columns, entities))
        return "\n\n".join([*([loud] if loud else []), head, *tables])

    def to_document(self) -> dict[str, Any]:
        """Return the report as a document of plain values, without the single failures."""
        names = "scene predicted duration rate diverged n effective_n seed horizon confidence greatest".split()
        estimates = ("observed", "whole", "energy", "own_loss", "secondary", "dropped", "spilled")
        return {
            **_SCHEMA,
            "healthy": self.healthy.to_document(),
            **{name: getattr(self, name) for name in names},
            **{name: asdict(getattr(self, name)) for name in estimates},
            "per_task": {
                "observed": asdict(self.observed_per_task),
                "healthy": self.certain_per_task,
                "predicted": self.predicted_per_task,
            },
            "by_fault": {name: asdict(estimate) for name, estimate in self.by_fault.items()},
            "by_entity": {name: asdict(entity) for name, entity in self.by_entity.items()},
            "versions": dict(self.versions),
        }

    def to_json(self, file: str | FilePath | None = None) -> str:
        """Return the document as JSON text, with null for NaN; write it to `file` if given."""
        text = documents.to_json(self.to_document()) + "\n"
        if file is not None:
            FilePath(file).write_text(text, encoding="utf-8")
        return text


def loudly(healthy: HealthyHarm) -> str:
    """Return a warning about harm without failure; "" if there is none."""
    return "" if healthy.harmless else f"HARM WITHOUT FAILURE: {healthy}"


def _cells(estimate: Estimate) -> tuple[float, str]:
    return estimate.mean, f"[{estimate.low:.3g}, {estimate.high:.3g}]"

"""What a validation says: records, a table to read, a JSON document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from failbench.basics.statistics import Estimate
from failbench.recording.healthy import HealthyHarm
from failbench.recording.records import Job
from graceful_plan import documents
from graceful_plan.array_types import Float

Array = np.ndarray

FAILURES_PER_HOUR = 1e-3
"""One failure in 1000 h: a round figure to state harm per executed task at, not a measured one. That harm is
proportional to it where the healthy robot does none, and ratios of it do not depend on it there."""
_SCHEMA = {"schema": "failbench.validation", "version": 3}
_SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True, kw_only=True)
class EntityReport:
    """What failures do to one entity.

    Args:
        probability: Probability that a failure makes the robot, the carried object or its contents touch it; of the
            carried object itself, that it is damaged.
        impact: Its share of the observed impact.
        predicted: Its share of the predicted impact.
    """

    probability: Estimate
    impact: Estimate
    predicted: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ValidationReport:
    """Observed impact of failures along a motion beside the predicted. Made by `validate`.

    Impacts are severities per failure, from its onset on. What the healthy robot spills, loses or touches comes with
    probability 1 and is no failure's: `healthy`. Failures come per hour, so what an executed task has to expect is that
    and the impact times the number of failures while it lasts: `observed_per_task`. Diverged rollouts are in no
    estimate; they are counted.

    | field       | meaning                                                                                         |
    |-------------|-------------------------------------------------------------------------------------------------|
    | scene       | name of the scene                                                                               |
    | healthy     | what the healthy robot does harm to, with probability 1                                         |
    | observed    | sum over components and entities of the severities of what is touched, with `own_loss` if the  |
    |             | prediction counts it                                                                            |
    | whole       | the same with what was hit before the failure began, each pair once; `observed` if nothing was  |
    | energy      | `observed`, each severity times the probability that the energy of the touch does damage          |
    | own_loss    | severity of the loss of the carried object itself, times the probability that it is damaged     |
    | secondary   | the same as `observed` for entities that other entities are knocked onto                        |
    | predicted   | mean of the planner's sum of P S over the times of the failures                                 |
    | duration    | of the motion [s]                                                                               |
    | rate        | failures per hour of motion                                                                     |
    | by_fault    | observed impact of each fault, by "NAME/DEGREE"                                                 |
    | by_entity   | share of each entity                                                                            |
    | dropped     | fraction of the rollouts in which the carried object left the gripper                           |
    | spilled     | lost fraction of the contents that were there at the onset                                      |
    | diverged    | rollouts whose simulation blew up                                                               |
    | n           | rollouts, with the diverged ones                                                                |
    | effective_n | rollouts of equal weight that would tell as much; n without importance sampling                 |
    | seed        | of everything random                                                                            |
    | horizon     | how long was simulated after each onset [s]                                                     |
    | confidence  | of the intervals                                                                                |
    | greatest    | severity of the worst single touch that is possible; guards the intervals                       |
    | versions    | of what computed this                                                                           |
    | jobs        | the failures                                                                                    |
    | impacts     | observed impact of each; NaN if it diverged                                                     |
    | wholes      | the same as in `whole`                                                                          |
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
    jobs: tuple[Job, ...]
    impacts: Float[Array, " n"]
    wholes: Float[Array, " n"]

    @property
    def failures_per_task(self) -> float:
        """Failures to be expected while the motion is executed once."""
        return self.rate * self.duration / _SECONDS_PER_HOUR

    @property
    def certain_per_task(self) -> float:
        """Harm of the healthy robot to be expected of executing the motion once: if nothing fails on the way."""
        return max(0.0, 1.0 - self.failures_per_task) * self.healthy.harm

    @property
    def observed_per_task(self) -> Estimate:
        """Harm to be expected of executing the motion once.

        Executions without a failure do what the healthy robot does, those with one what is in `whole`: the part that
        had happened before, and from the onset on the failure's. So nothing counts twice.
        """
        return self.whole.scaled(self.failures_per_task).shifted(self.certain_per_task)

    @property
    def predicted_per_task(self) -> float:
        """Predicted impact of failures to be expected of executing the motion once."""
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
        """Return everything but the single failures as a document of plain values."""
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
        """Return the document as JSON text, NaN as null; write it to `file` if one is given."""
        text = documents.to_json(self.to_document()) + "\n"
        if file is not None:
            FilePath(file).write_text(text, encoding="utf-8")
        return text


def loudly(healthy: HealthyHarm) -> str:
    """Return what people read first about harm without failure; "" if there is none."""
    return "" if healthy.harmless else f"HARM WITHOUT FAILURE: {healthy}"


def _cells(estimate: Estimate) -> tuple[float, str]:
    return estimate.mean, f"[{estimate.low:.3g}, {estimate.high:.3g}]"

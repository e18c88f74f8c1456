"""Events of failures in scenes that calibration has not seen, with predictions and observations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from benchmarks import suite
from failbench.calibrations import skill
from failbench.calibrations.failure_jobs import FailureJob, run_job
from failbench.calibrations.failures import Failures

Array = np.ndarray

BINS = 20
"""Number of bins, of equal counts of events or of predicted hits."""
FIGURES = ("events", "hits", "skill", "AUC", "ECE", "ratio", "log loss")
"""Names of the cells that `Events.figures` returns."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Events:
    """Events, one per row.

    | field     | meaning                                             |
    |-----------|-----------------------------------------------------|
    | scene     | name of the scene                                   |
    | motion    | number of the motion                                |
    | happened  | whether a contact happened                          |
    | predicted | probability of a contact, by model                  |
    | severity  | of the contact, if needed                           |
    | labels    | other classes of events, by name                    |
    """

    scene: Array
    motion: Array
    happened: Array
    predicted: Mapping[str, Array]
    severity: Array = field(default_factory=lambda: np.zeros(0))
    labels: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))

    def only(self, chosen: Array) -> Events:
        """Return the chosen events."""
        predicted = {name: p[chosen] for name, p in self.predicted.items()}
        severity = self.severity[chosen] if len(self.severity) else self.severity
        return Events(
            scene=self.scene[chosen],
            motion=self.motion[chosen],
            happened=self.happened[chosen],
            predicted=predicted,
            severity=severity,
            labels={name: values[chosen] for name, values in self.labels.items()},
        )

    def figures(self, model: str) -> Sequence[object]:
        """Return figures of a model's predictions, as cells of a table."""
        if not self.happened.any():
            return (len(self.happened), 0, *["-"] * 5)
        p = np.clip(self.predicted[model], 0.0, 1.0)
        found = skill.figures(p, self.happened, min(BINS, len(self.happened)))
        numbers = (found.brier_skill, found.auc, found.calibration_error, found.ratio, found.log_loss)
        return (found.events, found.happened, *(f"{x:.3f}" for x in numbers))


def fail(jobs: Sequence[FailureJob], options: suite.Options) -> tuple[list[Failures], list[str]]:
    """Simulate failures; return them in job order, and the reasons of motions without failures."""
    outcomes = dict(suite.spread(_numbered, list(enumerate(jobs)), options.processes, "motions"))
    ordered = [outcomes[i] for i in range(len(jobs))]
    return [x for x in ordered if isinstance(x, Failures)], [x for x in ordered if isinstance(x, str)]


def _numbered(job: tuple[int, FailureJob]) -> tuple[int, Failures | str]:
    return job[0], run_job(job[1])

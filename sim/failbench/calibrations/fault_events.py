"""Events of faults, paired with the probabilities that the generators' models predict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from failbench.calibrations.failures import Failures
from graceful_plan import Scene
from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.costs.fault_prior import FAILURES
from graceful_plan.exceptions import SettingError, ShapeError

GeneratorModel = Callable[[Scene, Failures], Mapping[str, Float[Array, "n c e"]]]
"""Returns P(component hits entity) by generator, for states at onsets, given that the failure is of that generator."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultEvents:
    """Events that one fault may have caused.

    | field       | meaning                                                  | shape       |
    |-------------|----------------------------------------------------------|-------------|
    | probability | P_g of each of `FAILURES`                              | n generator |
    | happened    | whether the event occurred                               | n           |
    | body        | whether the body touches, not the carried object         | n           |
    | motion      | index of the motion of the failure                       | n           |
    | scene       | name of the scene                                        | n           |
    """

    probability: Array
    happened: Array
    body: Array
    motion: Array
    scene: Array

    def __post_init__(self) -> None:
        # Checked here, not only by annotations, which are not enforced for users.
        n = len(self.probability)
        if self.probability.shape != (n, len(FAILURES)):
            raise ShapeError("probability", self.probability.shape, f"(n, {len(FAILURES)}), a column a generator")
        for name in ("happened", "body", "motion", "scene"):
            if getattr(self, name).shape != (n,):
                raise ShapeError(name, getattr(self, name).shape, f"({n},), as many as probabilities")
        if n and not (np.nanmin(self.probability) >= 0.0 and np.max(self.probability) <= 1.0):
            raise SettingError("probability", float(np.max(self.probability)), "numbers in [0, 1]")

    def __len__(self) -> int:
        return len(self.happened)

    def rows(self, chosen: Bool[Array, " n"]) -> FaultEvents:
        """Return a subset of the events."""
        return FaultEvents(
            probability=self.probability[chosen],
            happened=self.happened[chosen],
            body=self.body[chosen],
            motion=self.motion[chosen],
            scene=self.scene[chosen],
        )


def fault_events(
    failures: Sequence[Failures], scenes: Mapping[tuple[str, str], Scene], model: GeneratorModel
) -> dict[str, FaultEvents]:
    """Pair the predictions of the generators' models with observed events, by fault.

    Args:
        failures: Failures of any faults; each entry is one motion.
        scenes: Scenes with the object attached, by name of the scene and the task.
        model: The generators' models; generators that it leaves out have probability 0.
    """
    found: dict[str, list[FaultEvents]] = {}
    for motion, part in enumerate(failures):
        said = model(scenes[part.scene, part.task], part)
        nothing = np.zeros(part.hit.shape)
        P = np.stack([said.get(generator, nothing) for generator in FAILURES], axis=-1)[:, part.counted]
        hit = part.hit[:, part.counted]
        body = np.repeat([name == "body" for name in part.components], part.counted.sum(axis=1))
        for index in np.unique(part.fault):
            rows = part.fault == index
            count = hit[rows].size
            events = FaultEvents(
                probability=P[rows].reshape(count, len(FAILURES)),
                happened=hit[rows].reshape(count),
                body=np.tile(body, int(rows.sum())),
                motion=np.full(count, motion),
                scene=np.full(count, part.scene),
            )
            found.setdefault(part.faults[index], []).append(events)
    return {fault: _joined(parts) for fault, parts in found.items()}


def generator_probabilities(scene: Scene, failures: Failures) -> Mapping[str, Float[Array, "n component entity"]]:
    """Return the predictions of `FailureMixture` for failures of each single generator."""
    batch, found = failures.states(scene), {}
    for generator in FAILURES:
        prior = gp.FaultPrior({"it": 1.0}, {"it": {generator: 1.0}})
        found[generator] = gp.FailureMixture(faults=prior).probability(batch)
    return found


def _joined(parts: Sequence[FaultEvents]) -> FaultEvents:
    return FaultEvents(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("probability", "happened", "body", "motion", "scene")
        }
    )

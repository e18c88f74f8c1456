"""An interaction model that holds another one: the same answers, and nobody can know that the core has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

import graceful_plan as gp


@dataclass(frozen=True)
class Wrapped(gp.InteractionModel):
    """Another model, without its kernel and its gradient."""

    model: gp.InteractionModel = field(default_factory=gp.Footprint)

    @property
    def components(self) -> tuple[str, ...]:
        return self.model.components

    def probability(self, batch: gp.StateBatch) -> np.ndarray:
        return self.model.probability(batch)

    def sources(self, batch: gp.StateBatch) -> Mapping[str, np.ndarray]:
        return self.model.sources(batch)

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        return self.model.fault_shares()

"""An interaction model that wraps another one and hides that the core supports it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

import graceful_plan as gp
from graceful_plan.scene.harm.fragility import FragilityTable


@dataclass(frozen=True)
class Wrapped(gp.InteractionModel):
    """Another model, without its kernel and its gradient."""

    model: gp.InteractionModel = field(default_factory=gp.FailureMixture)

    @property
    def components(self) -> tuple[str, ...]:
        return self.model.components

    def probability(self, batch: gp.StateBatch) -> np.ndarray:
        return self.model.probability(batch)

    def sources(self, batch: gp.StateBatch) -> Mapping[str, np.ndarray]:
        return self.model.sources(batch)

    @property
    def knows_own_loss(self) -> bool:
        return self.model.knows_own_loss

    def own_loss(self, batch: gp.StateBatch, fragility: FragilityTable) -> Mapping[str, np.ndarray]:
        return self.model.own_loss(batch, fragility)

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        return self.model.fault_shares()

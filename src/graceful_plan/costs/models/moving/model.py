"""The treatment of entities that move, whatever the model of those that stand still."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.failing_base import FailingBase, failing_base
from graceful_plan.costs.models.moving.drops import moving_probability
from graceful_plan.costs.models.moving.kernel import moving_kernels
from graceful_plan.costs.models.moving.whereabouts import PLACES, check_places
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@final
@dataclass(frozen=True, kw_only=True)
class MovingModel:
    """Whom of those in `Scene.moving` failures hit: the drop model, that of a base, and a rule of thumb for the arm.

    Args:
        settings: Constants of the drop model.
        drop: P that the gripper lets go, given a failure.
        collapse: P that the arm collapses, given a failure.
        coast: P that it is the base that fails, given a failure, if the robot drives; the others share the rest. By
            default as `base` has it.
        base: How a base fails; by the shipped model by default.
        places: How many stand for where somebody may be who is expected somewhere.

    Raises:
        SettingError: If so many places cannot stand for anybody.
    """

    settings: DropSettings = field(default_factory=DropSettings.shipped)
    drop: float = 1.0
    collapse: float = 1.0
    coast: float | None = 0.0
    base: FailingBase | None = None
    places: int = PLACES

    def __post_init__(self) -> None:
        check_places(self.places)

    def sources(
        self, batch: StateBatch, components: Collection[str] = COMPONENTS
    ) -> Mapping[str, Float[Array, "n component moving"]]:
        """Return P(component hits moving entity | failure) by what goes wrong.

        Args:
            batch: States; without times, P is the mean over each entity's predicted path.
            components: Which to compute; the others are 0.
        """
        counted = [name for name in components if (self.collapse if name == "body" else self.drop) > 0.0]
        P = moving_probability(batch, self.settings, counted, self.places)
        falls = np.array([name != "body" for name in batch.scene.components])[:, None]
        base, coast = self._of_base(batch.scene)
        aboard = 1.0 - coast
        found = {"drop": aboard * self.drop * P * falls, "collapse": aboard * self.collapse * P * ~falls}
        if base is not None and coast > 0.0 and "body" in components:
            met = coast * base.met(batch)
            found["coast"] = np.where(falls, 0.0, met[:, None])
        return found

    def kernels(
        self, scene: Scene, severity: Float[Array, "component moving"], paces: tuple[float, float]
    ) -> list[ImpactKernel] | None:
        """Return native kernels that together guide a search, None if arm or base count, of which there are none.

        Law: close to sums of P S from `sources` without times; they need not be the same.
        """
        falls = np.array([name != "body" for name in scene.components])
        if (self.collapse > 0.0 or self._of_base(scene)[1] > 0.0) and (severity[~falls] > 0.0).any():
            return None
        return moving_kernels(scene, self.settings, self.drop * severity[falls].sum(axis=0), paces)

    def _of_base(self, scene: Scene) -> tuple[FailingBase | None, float]:
        """Return how the base of a scene fails, and P that it does; None and 0 for a robot without one."""
        if self.coast == 0.0 or (base := failing_base(scene, self.base)) is None:
            return None, 0.0
        return base, base.share if self.coast is None else self.coast

"""The treatment of entities that move, whatever the model of those that stand still."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.coast.constants import CoastSettings
from graceful_plan.costs.models.coast.native import reals
from graceful_plan.costs.models.coast.walkers import moving_coast
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.moving.drops import moving_arm, moving_drop, moving_table
from graceful_plan.costs.models.moving.kernel import moving_kernels
from graceful_plan.costs.models.moving.whereabouts import PLACES, check_places
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@final
@dataclass(frozen=True, eq=False)
class _Failure:
    """One of the failures: its name and probability, the components that it strikes with, and whom it hits."""

    name: str
    weight: float
    strikes: Bool[Array, " component"]
    native: _native.MovingSource


@final
@dataclass(frozen=True, kw_only=True)
class MovingModel:
    """Whom of those in `Scene.moving` failures hit: the drop and coast models, and a rule of thumb for the arm.

    Args:
        settings: Constants of the drop model.
        drop: P that the gripper lets go, given a failure.
        collapse: P that the arm collapses, given a failure.
        coast: P that it is the base that fails, given a failure, if the robot drives; the others share the rest.
        base: Constants of the coast model.
        places: How many stand for where somebody may be who is expected somewhere.

    Raises:
        SettingError: If so many places cannot stand for anybody.
    """

    settings: DropSettings = field(default_factory=DropSettings.shipped)
    drop: float = 1.0
    collapse: float = 1.0
    coast: float = 0.0
    base: CoastSettings = field(default_factory=CoastSettings.shipped)
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
        scene = batch.scene
        q, qd = reals(batch.q), reals(batch.qd)
        time = None if batch.time is None else reals(batch.time)
        shape = len(batch), len(scene.components), len(scene.moving)
        found = {name: np.zeros(shape) for name in ("drop", "collapse")}
        for failure in self._failures(scene, components):
            P = failure.weight * failure.native.probability(q, qd, time)
            found[failure.name] = np.where(failure.strikes[:, None], P[:, None], 0.0)
        return found

    def impact(self, scene: Scene, severity: Float[Array, "component moving"]) -> _native.MovingImpact:
        """Return sums of P S at times with their derivatives, and gaps between the robot and moving entities."""
        impact = _native.MovingImpact(compile_scene(scene).kernels.core, moving_table(scene))
        for failure in self._failures(scene, COMPONENTS):
            impact.add(failure.native, reals(failure.weight * severity[failure.strikes].sum(axis=0)))
        return impact

    def _failures(self, scene: Scene, components: Collection[str]) -> Iterator[_Failure]:
        """Yield what may go wrong for some components."""
        drives = scene.base is not None and self.coast > 0.0
        aboard = 1.0 - self.coast if scene.base is not None else 1.0
        falls = np.array([name != "body" and name in components for name in scene.components])
        body = np.array([name == "body" and name in components for name in scene.components])
        if self.drop > 0.0 and scene.carried is not None and falls.any():
            yield _Failure("drop", aboard * self.drop, falls, moving_drop(scene, self.settings, self.places))
        if self.collapse > 0.0 and body.any():
            yield _Failure("collapse", aboard * self.collapse, body, moving_arm(scene))
        if drives and body.any():
            yield _Failure("coast", self.coast, body, moving_coast(scene, self.base))

    def kernels(
        self, scene: Scene, severity: Float[Array, "component moving"], paces: tuple[float, float]
    ) -> list[ImpactKernel] | None:
        """Return native kernels that together guide a search, None if arm or base count, of which there are none.

        Law: close to sums of P S from `sources` without times; they need not be the same.
        """
        falls = np.array([name != "body" for name in scene.components])
        drives = scene.base is not None and self.coast > 0.0
        if (self.collapse > 0.0 or drives) and (severity[~falls] > 0.0).any():
            return None
        return moving_kernels(scene, self.settings, self.drop * severity[falls].sum(axis=0), paces)

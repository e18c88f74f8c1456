"""Hits on moving entities, independent of the model for static entities."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel, reals
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.failing_base import FailingBase, failing_base
from graceful_plan.costs.models.moving.drops import moving_arm, moving_drop, moving_table
from graceful_plan.costs.models.moving.kernel import moving_kernels
from graceful_plan.costs.models.moving.position_samples import PLACES, check_places
from graceful_plan.path import plain_numbers
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.scene import Scene

_ROUGH_PLACES = 12
"""Number of sample positions of a moving entity in the drop model of searches."""


@final
@dataclass(frozen=True, eq=False)
class _Failure:
    """A kind of failure: name, probability, the components that hit, and the native model of the hits."""

    name: str
    weight: float
    strikes: Bool[Array, " component"]
    native: _native.MovingSource


@final
@dataclass(frozen=True, kw_only=True)
class MovingModel:
    """Hits of failures on `Scene.moving`: the drop model, a model of the base, and a rule of thumb for the arm.

    Args:
        settings: Constants of the drop model.
        drop: P that the gripper lets go, given a failure.
        collapse: P that the arm collapses, given a failure.
        coast: P that the base fails, given a failure of a mobile robot; the other failures share the rest. None takes
            both shares from `base`, which knows the scene's robot.
        base: Model of a failing base; the shipped one by default.
        places: Number of sample positions for the uncertain position of a moving entity.

    Raises:
        SettingError: If `places` is not supported.
    """

    settings: DropSettings = field(default_factory=DropSettings.shipped)
    drop: float = 1.0
    collapse: float = 1.0
    coast: float | None = 0.0
    base: FailingBase | None = None
    places: int = PLACES

    def __post_init__(self) -> None:
        plain_numbers(self)
        check_places(self.places)

    def sources(
        self, batch: StateBatch, components: Collection[str] = COMPONENTS
    ) -> Mapping[str, Float[Array, "n component moving"]]:
        """Return P(component hits moving entity | failure) by kind of failure.

        Args:
            batch: States; without times, P is the mean over each entity's predicted path.
            components: Components to compute; the others are 0.
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

    def impact(
        self, scene: Scene, severity: Float[Array, "component moving"], *, rough: bool = False
    ) -> _native.MovingImpact:
        """Return the native sums of P S at times with derivatives, and gaps between robot and moving entities.

        Args:
            scene: The scene.
            severity: Severity of each component and moving entity.
            rough: Whether to use a faster approximation, for descents and searches.
        """
        impact = _native.MovingImpact(compile_scene(scene).kernels.core, moving_table(scene))
        for failure in self._failures(scene, COMPONENTS, rough=rough):
            impact.add(failure.native, reals(failure.weight * severity[failure.strikes].sum(axis=0)))
        return impact

    def _failures(self, scene: Scene, components: Collection[str], *, rough: bool = False) -> Iterator[_Failure]:
        """Yield the kinds of failure that involve these components."""
        base, coast, aboard = self._shares(scene)
        places = min(_ROUGH_PLACES, self.places) if rough else self.places
        falls = np.array([name != "body" and name in components for name in scene.components])
        body = np.array([name == "body" and name in components for name in scene.components])
        if self.drop > 0.0 and scene.carried is not None and falls.any():
            yield _Failure("drop", aboard * self.drop, falls, moving_drop(scene, self.settings, places))
        if self.collapse > 0.0 and body.any():
            yield _Failure("collapse", aboard * self.collapse, body, moving_arm(scene))
        if base is not None and coast > 0.0 and body.any():
            hit = np.array([name in base.hits_with(scene) and name in components for name in scene.components])
            yield _Failure("coast", coast, hit, (base.roughly() if rough else base).meeting(scene))

    def kernels(
        self, scene: Scene, severity: Float[Array, "component moving"], paces: tuple[float, float]
    ) -> list[ImpactKernel] | None:
        """Return native kernels whose sum guides a search, None if arm or base count, which have no such kernels.

        Law: an approximation of the sums of P S from `sources` without times.
        """
        falls = np.array([name != "body" for name in scene.components])
        if (self.collapse > 0.0 or self._shares(scene)[1] > 0.0) and (severity[~falls] > 0.0).any():
            return None
        return moving_kernels(scene, self.settings, self.drop * severity[falls].sum(axis=0), paces)

    def _shares(self, scene: Scene) -> tuple[FailingBase | None, float, float]:
        """Return the model of a scene's base, P that the base fails, and P that gripper, arm or cargo do."""
        if self.coast == 0.0 or (base := failing_base(scene, self.base)) is None:
            return None, 0.0, 1.0
        if self.coast is None:
            return base, base.of_base(scene), base.of_cargo(scene)
        return base, self.coast, 1.0 - self.coast

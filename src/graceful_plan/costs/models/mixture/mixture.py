"""The default interaction model: drops, spills and failing arms, weighted by a fault prior (`FaultPrior`).

The specifications of these models are in the packages `drop`, `spill` and `body`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from operator import add
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.consequence import damaged_by_body
from graceful_plan.costs.cost import AHEAD, StateBatch
from graceful_plan.costs.fault_prior import FaultPrior
from graceful_plan.costs.models.body.body import BodyModel
from graceful_plan.costs.models.body.constants import GENERATORS, BodySettings
from graceful_plan.costs.models.body.tables import ROWS as HOLDING
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, DropKernel, drop_kernel
from graceful_plan.costs.models.drop.network import DropNetwork
from graceful_plan.costs.models.failing_base import FailingBase, failing_base
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.costs.models.moving.position_samples import PLACES, check_places
from graceful_plan.costs.models.spill.constants import SpillSettings, StopSettings
from graceful_plan.costs.native_model import NativeModel, OwnLoss
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.scene import Scene

FALLING = ("carried", "contents")
"""Components that fall when the gripper lets go."""
_SOURCE = {"carried": (("carried", "drop"),), "contents": (("dropped", "drop"), ("held", "spill"), ("stopped", "stop"))}
"""Rows of the drop kernel for each component, with the generator that causes each."""


@final
@dataclass(frozen=True)
class FailureMixture(NativeModel):
    """Mixture of the models of drops, spills and failing arms, in the native core.

    Args:
        faults: A fault prior or the name of a preset: "drop_only", the gripper lets go; "arm"; "service_robot". Models
            of failing arms take several times longer than those of drops and spills.
        settings: Constants of the drop model; the shipped ones by default.
        spill: Constants of the spill model; the shipped ones by default.
        body: Constants of the body model; the shipped ones by default.
        stop: Constants of the protective stop and its spills; the shipped ones by default.
        base: Model of a failing base with its share of the failures, such as `Coast(settings)`; the shipped model by
            default. Ignored for robots without a base.
        network: Correction of the object's hits after a drop, such as `DropNetwork.shipped()`; none by default.
        places: Number of sample positions for the uncertain position of a moving entity; searches use fewer.
        damage: Fragilities of the entities: P is then that of damage by the energy of the hit (`costs.consequence`),
            apart from moving entities and failures of a base, whose hits count in full. By default P of a hit.

    Raises:
        UnknownNameError: If there is no such preset.
        SettingError: If `places` is not supported, or `base` is not a FailingBase.
    """

    faults: str | FaultPrior = "drop_only"
    settings: DropSettings = field(default_factory=DropSettings.shipped)
    spill: SpillSettings = field(default_factory=SpillSettings.shipped)
    body: BodySettings = field(default_factory=BodySettings.shipped)
    stop: StopSettings = field(default_factory=StopSettings.shipped)
    base: FailingBase | None = None
    network: DropNetwork | None = None
    places: int = PLACES
    damage: FragilityTable | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        check_places(self.places)
        if not isinstance(self.faults, str | FaultPrior):
            raise SettingError("faults", self.faults, "a FaultPrior or the name of a preset")
        if not (self.base is None or isinstance(self.base, FailingBase)):
            raise SettingError("base", self.base, "a FailingBase, such as Coast(settings)")
        _ = self.prior

    @cached_property
    def prior(self) -> FaultPrior:
        """The fault prior."""
        return FaultPrior.preset(self.faults) if isinstance(self.faults, str) else self.faults

    @property
    def components(self) -> tuple[str, ...]:
        """Components that count by default; the robot's body does if the prior includes failures of the arm."""
        return COMPONENTS if self._arm_weights.any() else FALLING

    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P of a contact, summed over all kinds of failure."""
        none = np.zeros((len(batch), len(batch.scene.components), len(batch.scene.entities)))
        return sum(self.sources(batch).values(), none)

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component entity"]]:
        """Return P of a contact by generator, for generators with a weight."""
        found = {**self._gripper_sources(batch), **self._arm_sources(batch)}
        base = failing_base(batch.scene, self.base)
        if base is None:
            return found
        coast = base.of_base(batch.scene) * base.probability(batch)
        aboard = base.of_cargo(batch.scene)
        return {**{name: aboard * P for name, P in found.items()}, "coast": coast}

    @property
    def knows_own_loss(self) -> bool:
        """Whether the gripper may let go. Damage to an object that a failing arm still holds is not modelled."""
        return self.prior.weights()["drop"] > 0.0

    def own_loss(self, batch: StateBatch, fragility: FragilityTable) -> Mapping[str, Float[Array, " n"]]:
        """Return P that the fall of the carried object damages it."""
        if batch.scene.carried is None or not self.knows_own_loss or not len(batch):
            return {"drop": np.zeros(len(batch))}
        kernel = self._drop_kernel(batch.scene, OwnLoss(0.0, fragility))
        weight = self._of_cargo(batch.scene) * self.prior.weights()["drop"]
        return {"drop": weight * kernel.of(batch)[1]}

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        """Return the faults behind each source, with their weights."""
        return self.prior.fault_shares()

    def moving(self) -> MovingModel:
        """Return the model for moving entities, with the constants and weights of this model."""
        weights = self.prior.weights()
        shares = {"drop": weights["drop"], "collapse": weights["collapse"]}
        return MovingModel(settings=self.settings, coast=None, base=self.base, places=self.places, **shares)

    def kernel(
        self,
        scene: Scene,
        severity: Float[Array, "component entity"],
        paces: tuple[float, float],
        own: OwnLoss | None = None,
    ) -> ImpactKernel:
        """Return the native kernel; if the arm may fail, its derivatives along edges are approximate."""
        parts: list[ImpactKernel] = []
        if (base := failing_base(scene, self.base)) is not None:
            parts.append(base.kernel(scene, base.of_base(scene) * severity, paces))
            severity = base.of_cargo(scene) * severity
        rows, loss = self._severities(scene, severity), self._of_cargo(scene) * self._own_severity(own)
        if scene.carried is not None and (rows.any() or loss):
            parts.append(self._drop_kernel(scene, own).with_severity(rows, paces, own=loss))
        weights = self._arm_weights
        if weights.any() and severity.any():
            harm = severity * self._damage_of_body(scene)
            parts.append(BodyModel(self._noticed_body).kernel(scene, harm, weights, paces))
        if not parts:  # the impact is 0
            return compile_scene(scene).kernels.overlap(np.zeros_like(severity))
        return reduce(add, parts)

    def gradient(self, batch: StateBatch, severity: Float[Array, "component entity"]) -> Float[Array, "n nq"] | None:
        """Return the derivative of sums of P S, None if the arm may fail."""
        found = self.gradients(batch, severity)
        return None if found is None else found[0]

    def gradients(
        self, batch: StateBatch, severity: Float[Array, "component entity"], own: OwnLoss | None = None
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return the derivatives with respect to q and to the joint velocities, None if the arm may fail.

        Those of the body model are approximate, for descents only: see `BodyModel.impact_gradient`.
        """
        if self._arm_weights.any():
            return None
        scene, aboard = batch.scene, self._of_cargo(batch.scene)
        found = np.zeros_like(batch.q), np.zeros_like(batch.q)
        if (base := failing_base(scene, self.base)) is not None:
            found = base.gradients(batch, base.of_base(scene) * severity)
        if scene.carried is None:
            return found
        kernel, rows = self._drop_kernel(scene, own), self._severities(scene, aboard * severity)
        of_drop = kernel.gradient(batch.q, rows, batch.qd, own=aboard * self._own_severity(own))[1:]
        return found[0] + of_drop[0], found[1] + of_drop[1]

    def widened(self, metres: float) -> FailureMixture:
        """Return a model with additional uncertainty of release positions and distances: a standard deviation [m]."""
        wide = self.settings.widened(metres), self.spill.widened(metres), self.body.widened(metres)
        return replace(self, settings=wide[0], spill=wide[1], body=wide[2], stop=self.stop.widened(metres))

    def _of_cargo(self, scene: Scene) -> float:
        """Return P that gripper or arm fails, or that a base throws off its cargo, given a failure."""
        base = failing_base(scene, self.base)
        return 1.0 if base is None else base.of_cargo(scene)

    def _gripper_sources(self, batch: StateBatch) -> dict[str, Float[Array, "n component entity"]]:
        """Return the sources of the gripper: drops, spills and stops."""
        scene, weights = batch.scene, self.prior.weights()
        names = [name for name in ("drop", "spill", "stop") if weights[name] > 0.0]
        found = {name: np.zeros((len(batch), len(scene.components), len(scene.entities))) for name in names}
        if scene.carried is None or not len(batch) or not names:
            return found
        P, _ = self._drop_kernel(scene, None).of(batch)
        P = P * self._damage_by_row(scene)
        for row, component in enumerate(scene.components):
            for own, source in _SOURCE.get(component, ()):
                if source in found:
                    found[source][:, row] += weights[source] * P[:, ROWS.index(own)]
        return found

    def _arm_sources(self, batch: StateBatch) -> dict[str, Float[Array, "n component entity"]]:
        """Return the sources of failing arms."""
        scene, weights = batch.scene, self._arm_weights
        if not weights.any():
            return {}
        body, after = self._noticed_body, self.prior.noticed_after
        known = batch.ahead if np.isclose(body.step, AHEAD[0]) else None
        if known is not None and after is not None:
            known = known[:, : max(1, int(np.searchsorted(AHEAD, after * (1.0 - 1e-9))) + 1)]
        P = BodyModel(body).probability(batch, known) * self._damage_of_body(scene)
        found: dict[str, Float[Array, "n component entity"]] = {}
        for g, name in enumerate(GENERATORS):
            if weights[g].any():
                found[name] = np.zeros((len(batch), len(scene.components), len(scene.entities)))
                for row, component in enumerate(scene.components):
                    if component in HOLDING:
                        k = HOLDING.index(component)
                        found[name][:, row] = weights[g, k] * P[:, g, k]
        return found

    @cached_property
    def _noticed_body(self) -> BodySettings:
        """Constants of failing arms, whose failures end when they are noticed."""
        after = self.prior.noticed_after
        return self.body if after is None else self.body.within(after)

    @cached_property
    def _arm_weights(self) -> Float[Array, "generator 2"]:
        """Weight of each of `GENERATORS` for the arm and for the object that it still holds."""
        weights, held = self.prior.weights(), self.prior.held_weights()
        return np.array([[weights[name], held[name]] for name in GENERATORS])

    def _drop_kernel(self, scene: Scene, own: OwnLoss | None) -> DropKernel:
        fragility = None if own is None else own.fragility
        return drop_kernel(scene, self.settings, self.spill, fragility, self.stop, self.network, self.damage)

    def _damage_by_row(self, scene: Scene) -> Float[Array, "row entity"]:
        """Return P(damage | hit) for the rows of the drop kernel that the kernel does not multiply by it."""
        factors = np.ones((len(ROWS), len(scene.entities)))
        if self.damage is not None:
            factors[1:] = [self.damage.of(entity.category).wetted for entity in scene.entities.values()]
        return factors

    def _damage_of_body(self, scene: Scene) -> Float[Array, " entity"]:
        """Return P(damage | hit) for a failing arm and the object that it still holds."""
        if self.damage is None:
            return np.ones(len(scene.entities))
        return np.array([damaged_by_body(self.damage.of(entity.category)) for entity in scene.entities.values()])

    def _own_severity(self, own: OwnLoss | None) -> float:
        return 0.0 if own is None else self.prior.weights()["drop"] * own.severity

    def _severities(self, scene: Scene, severity: Float[Array, "component entity"]) -> Float[Array, "row entity"]:
        """Return severities in the rows of the drop kernel, multiplied by the weights of their sources."""
        rows, weights = np.zeros((len(ROWS), severity.shape[1])), self.prior.weights()
        for own, component in zip(severity, scene.components, strict=True):
            for row, source in _SOURCE.get(component, ()):
                rows[ROWS.index(row)] = weights[source] * own
        return rows * self._damage_by_row(scene)

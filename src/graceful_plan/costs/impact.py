"""Failure impact: who is hit if the robot fails here, times how bad that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.consequence import Damage
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.models.published.box_overlap import BoxOverlap
from graceful_plan.costs.native_model import NativeModel, moving_model
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.scene import Scene

Array = np.ndarray

MODELS: dict[str, type[InteractionModel]] = {"aabb": BoxOverlap, "footprint": Footprint}
"""Interaction models by the word that selects them in `ImpactCost(model=...)`."""
CONSEQUENCES = ("contact", "energy")
"""Words for what counts in `ImpactCost(consequence=...)`."""
OF_MODEL = ("those of the model",)
"""Stands for components that are not given: none at all is something else."""


@final
@dataclass(frozen=True)
class ImpactCost(Cost):
    """I(q) = sum over components and entities, also those that move, of P S.

    P is the probability of a contact, or that of damage, where a hard contact counts more than a soft one. The latter
    has neither gradient nor native kernel: planners fall back to NumPy and do far fewer iterations in the same time.

    Args:
        model: An interaction model, or the word for one of `MODELS`.
        components: Which parts of the robot count: "body", "carried", "contents"; by default those that the model
            says (`InteractionModel.components`); () for none. Those that a scene does not have contribute nothing.
        consequence: What P is about: "contact"; "energy", damage by the energy of the contact and the shipped table of
            fragilities (`costs.consequence`); or a table of one's own.

    Raises:
        UnknownNameError: If there is no such model, component or consequence.
    """

    model: str | InteractionModel = "footprint"
    components: tuple[str, ...] = OF_MODEL
    consequence: str | FragilityTable = "contact"

    def __post_init__(self) -> None:
        if isinstance(self.model, str) and self.model not in MODELS:
            raise UnknownNameError("interaction model", self.model, MODELS)
        if not isinstance(self.model, str | InteractionModel):
            raise SettingError("model", self.model, "an InteractionModel or the word for one")
        if isinstance(self.components, str):
            raise SettingError("components", self.components, f"several names: ({self.components!r},)")
        if self.components is OF_MODEL:
            model = MODELS[self.model]() if isinstance(self.model, str) else self.model
            object.__setattr__(self, "components", model.components)
        for name in self.components:
            if name not in COMPONENTS:
                raise UnknownNameError("component", name, COMPONENTS)
        if isinstance(self.consequence, str) and self.consequence not in CONSEQUENCES:
            raise UnknownNameError("consequence", self.consequence, CONSEQUENCES)
        if not isinstance(self.consequence, str | FragilityTable):
            raise SettingError("consequence", self.consequence, f"a FragilityTable or one of {', '.join(CONSEQUENCES)}")

    @property
    def interaction(self) -> InteractionModel:
        """The interaction model; where damage counts, one whose probabilities are those of damage."""
        contact = MODELS[self.model]() if isinstance(self.model, str) else self.model
        if self.consequence == "contact":
            return contact
        return Damage(contact, FragilityTable.shipped() if isinstance(self.consequence, str) else self.consequence)

    def severity(self, scene: Scene) -> Float[Array, "component entity"]:
        """S of each of the scene's components against each entity, zero for components that do not count."""
        rows = [
            [entity.severity[name] if name in self.components else 0.0 for entity in scene.entities.values()]
            for name in scene.components
        ]
        return np.array(rows, dtype=np.float64).reshape(len(scene.components), len(scene.entities))

    def hazard_severity(self, scene: Scene) -> Float[Array, "component hazard"]:
        """S of each component against each entity and, after these, each moving entity: see `Scene.hazards`."""
        moving = [
            [severity[name] if name in self.components else 0.0 for severity in scene.moving_severity.values()]
            for name in scene.components
        ]
        shape = len(scene.components), len(scene.moving)
        return np.concatenate([self.severity(scene), np.array(moving, dtype=np.float64).reshape(shape)], axis=1)

    def probability(self, batch: StateBatch) -> Float[Array, "n component hazard"]:
        """P of each component against each entity and each moving entity, given a failure at each state."""
        still = self.interaction.probability(batch)
        if not batch.scene.moving:
            return still
        moving = sum(moving_model(self.interaction).sources(batch, self.components).values())
        return np.concatenate([still, np.asarray(moving)], axis=2)

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component hazard"]]:
        """Return `probability` by what goes wrong."""
        still, scene = self.interaction.sources(batch), batch.scene
        if not scene.moving:
            return still
        moving = moving_model(self.interaction).sources(batch, self.components)
        rows = len(batch), len(scene.components)
        none, none_moving = np.zeros((*rows, len(scene.entities))), np.zeros((*rows, len(scene.moving)))
        return {
            name: np.concatenate([still.get(name, none), moving.get(name, none_moving)], axis=2)
            for name in dict.fromkeys([*still, *moving])
        }

    def state(self, batch: StateBatch) -> Float[Array, " n"]:
        """Expected severity given a failure at each state."""
        return np.einsum("nce,ce->n", self.probability(batch), self.hazard_severity(batch.scene))

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"] | None:
        """Derivative of the expected severity with respect to q at constant velocity, None if the model has none."""
        if batch.scene.moving:
            return None
        return self.interaction.gradient(batch, self.severity(batch.scene))

    def gradients(self, batch: StateBatch) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Derivatives with respect to q and to the joint velocities [s/rad], None if the model has none."""
        model = self.interaction
        if batch.scene.moving or not isinstance(model, NativeModel):
            return None
        return model.gradients(batch, self.severity(batch.scene))

    def widened(self, metres: float) -> ImpactCost | None:
        """Return a cost that smears hits by so much more, None if there is none; see `NativeModel.widened`."""
        model = self.interaction
        wide = model.widened(metres) if isinstance(model, NativeModel) else None
        return None if wide is None else replace(self, model=wide)

    def kernel(self, scene: Scene, paces: tuple[float, float]) -> ImpactKernel | None:
        """Return the native kernel that computes the same, None if there is none; see `NativeModel.kernel`.

        Of entities that move it is only close: see `MovingModel.kernels`.
        """
        model = self.interaction
        still = model.kernel(scene, self.severity(scene), paces) if isinstance(model, NativeModel) else None
        if still is None or not scene.moving:
            return still
        severity = self.hazard_severity(scene)[:, len(scene.entities) :]
        moving = moving_model(model).kernels(scene, severity, paces)
        return None if moving is None else reduce(add, moving, still)

    def is_published(self) -> bool:
        """Whether this is the published model, Algorithm 1, which a verdict can recompute on its own."""
        return isinstance(self.interaction, BoxOverlap)

"""Impact of a failure: the probability that each entity is hit times the severity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.consequence import Damage
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.mixture.mixture import FailureMixture
from graceful_plan.costs.models.published.box_overlap import BoxOverlap
from graceful_plan.costs.native_model import NativeModel, OwnLoss, moving_model
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.elements import COMPONENTS
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.scene import Scene

MODELS: dict[str, type[InteractionModel]] = {"box_overlap": BoxOverlap, "mixture": FailureMixture}
"""Interaction models by the name that selects them in `ImpactCost(model=...)`."""
CONSEQUENCES = ("contact", "energy")
"""Names of the consequences in `ImpactCost(consequence=...)`."""
DEFAULT_COMPONENTS = ("those of the model",)
"""Default of `ImpactCost.components`; an empty tuple means no components at all."""


def _struck_itself(scene: Scene) -> Float[Array, " component"]:
    """Return 1 for the component that represents the carried object itself, 0 for all others."""
    return np.array([float(name == "carried") for name in scene.components])


@final
@dataclass(frozen=True)
class ImpactCost(Cost):
    """I(q): the sum of P S over components and entities, including moving entities.

    P is the probability of a contact, or that of damage, where a hard contact counts more than a soft one. With damage
    and another model than the mixture there is neither gradient nor native kernel: planners fall back to NumPy and do
    far fewer iterations in the same time.

    The carried object itself counts as an entity, under its own name. Its S is the severity of its loss (row "carried"
    of the table of severities). Its P is the probability that its fall damages it, which depends on the height of the
    fall and on the surface that it lands on.

    Args:
        model: An interaction model, or its name in `MODELS`.
        components: Components of the robot that count: "body", "carried", "contents". The default is
            `InteractionModel.components`; () is none. Components that a scene does not have contribute nothing.
        consequence: The event that P is about: "contact"; "energy", damage by the energy of the contact with the
            shipped table of fragilities (`costs.consequence`); or another table of fragilities.
        own_loss: Whether the loss of the carried object itself counts, with models that support it; Algorithm 1 does
            not. Its fragility is that of `consequence` if that is a table, or else that of the shipped table.

    Raises:
        UnknownNameError: If there is no such model, component or consequence.
    """

    model: str | InteractionModel = "mixture"
    components: tuple[str, ...] = DEFAULT_COMPONENTS
    consequence: str | FragilityTable = "contact"
    own_loss: bool = True

    def __post_init__(self) -> None:
        plain_numbers(self)
        if isinstance(self.model, str) and self.model not in MODELS:
            raise UnknownNameError("interaction model", self.model, MODELS)
        if not isinstance(self.model, str | InteractionModel):
            raise SettingError("model", self.model, "an InteractionModel or the word for one")
        if isinstance(self.components, str):
            raise SettingError("components", self.components, f"several names: ({self.components!r},)")
        if self.components is DEFAULT_COMPONENTS:
            model = MODELS[self.model]() if isinstance(self.model, str) else self.model
            object.__setattr__(self, "components", model.components)
        for name in self.components:
            if name not in COMPONENTS:
                raise UnknownNameError("component", name, COMPONENTS)
        if isinstance(self.consequence, str) and self.consequence not in CONSEQUENCES:
            raise UnknownNameError("consequence", self.consequence, CONSEQUENCES)
        if not isinstance(self.consequence, str | FragilityTable):
            raise SettingError("consequence", self.consequence, f"a FragilityTable or one of {', '.join(CONSEQUENCES)}")

    @cached_property
    def interaction(self) -> InteractionModel:
        """The interaction model; with a consequence of damage, one whose probabilities are those of damage."""
        contact = MODELS[self.model]() if isinstance(self.model, str) else self.model
        if self.consequence == "contact":
            return contact
        if isinstance(contact, FailureMixture):
            return replace(contact, damage=self.fragility)
        return Damage(contact, self.fragility)

    def severity(self, scene: Scene) -> Float[Array, "component entity"]:
        """Return S of each of the scene's components against each entity, zero for components that do not count."""
        counted = self.counted(scene)
        rows = [
            [entity.severity[name] if name in counted else 0.0 for entity in scene.entities.values()]
            for name in scene.components
        ]
        return np.array(rows, dtype=np.float64).reshape(len(scene.components), len(scene.entities))

    def counted(self, scene: Scene) -> tuple[str, ...]:
        """Return the components that count in a scene; with the default ones, also the body of a mobile base."""
        drives = scene.base is not None and "body" in scene.components and "body" not in self.components
        return (*self.components, "body") if drives and self._default else self.components

    @property
    def _default(self) -> bool:
        """Whether `components` are the defaults of a model that includes failures of the base."""
        model = self.interaction
        return isinstance(model, FailureMixture) and self.components == model.components

    def counts_own_loss(self, scene: Scene) -> bool:
        """Tell whether the loss of the carried object itself counts."""
        carried = scene.carried is not None and "carried" in self.components
        return self.own_loss and carried and self.interaction.knows_own_loss

    def harmed_entities(self, scene: Scene) -> tuple[str, ...]:
        """Return the names of all that may be harmed: entities, moving entities, last the carried object itself."""
        if scene.carried is None or not self.counts_own_loss(scene):
            return scene.entity_names
        return (*scene.entity_names, scene.carried.body)

    def severity_table(self, scene: Scene) -> Float[Array, "component harmed"]:
        """Return S by component and name in `harmed_entities`; only the component "carried" harms the object itself."""
        counted = self.counted(scene)
        moving = [
            [severity[name] if name in counted else 0.0 for severity in scene.moving_severity.values()]
            for name in scene.components
        ]
        shape = len(scene.components), len(scene.moving)
        parts = [self.severity(scene), np.array(moving, dtype=np.float64).reshape(shape)]
        if self.counts_own_loss(scene):
            parts.append(scene.own_severity * _struck_itself(scene)[:, None])
        return np.concatenate(parts, axis=1)

    def probability(self, batch: StateBatch) -> Float[Array, "n component harmed"]:
        """Compute P of each component against each of `harmed_entities`, given a failure at each state."""
        parts, scene = [self.interaction.probability(batch)], batch.scene
        if scene.moving:
            parts.append(np.asarray(sum(moving_model(self.interaction).sources(batch, self.counted(scene)).values())))
        if self.counts_own_loss(scene):
            parts.append(np.asarray(sum(self._own_sources(batch).values())))
        return np.concatenate(parts, axis=2)

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component harmed"]]:
        """Return `probability` by kind of failure."""
        scene = batch.scene
        parts = [(self.interaction.sources(batch), len(scene.entities))]
        if scene.moving:
            parts.append((moving_model(self.interaction).sources(batch, self.counted(scene)), len(scene.moving)))
        if self.counts_own_loss(scene):
            parts.append((self._own_sources(batch), 1))
        rows = len(batch), len(scene.components)
        return {
            name: np.concatenate([part.get(name, np.zeros((*rows, columns))) for part, columns in parts], axis=2)
            for name in dict.fromkeys(name for part, _ in parts for name in part)
        }

    def _own_sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component 1"]]:
        """Compute P that the carried object itself is damaged, by kind of failure."""
        found, row = self.interaction.own_loss(batch, self.fragility), _struck_itself(batch.scene)
        return {name: P[:, None, None] * row[:, None] for name, P in found.items()}

    @property
    def fragility(self) -> FragilityTable:
        """Table of fragilities."""
        return FragilityTable.shipped() if isinstance(self.consequence, str) else self.consequence

    def own(self, scene: Scene) -> OwnLoss | None:
        """Return severity and fragility of the carried object's own loss in a scene, None if it does not count."""
        return OwnLoss(scene.own_severity, self.fragility) if self.counts_own_loss(scene) else None

    def state(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the expected severity given a failure at each state."""
        return np.einsum("nce,ce->n", self.probability(batch), self.severity_table(batch.scene))

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"] | None:
        """Return the gradient of the expected severity in q at constant velocity, None if the model has none."""
        model, scene = self.interaction, batch.scene
        if isinstance(model, NativeModel):
            found = self.gradients(batch)
            return None if found is None else found[0]
        if scene.moving or self.counts_own_loss(scene):
            return None
        return model.gradient(batch, self.severity(scene))

    def gradients(self, batch: StateBatch) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return derivatives with respect to q and to the joint velocities [s/rad], None if the model has none."""
        model = self.interaction
        if batch.scene.moving or not isinstance(model, NativeModel):
            return None
        return model.gradients(batch, self.severity(batch.scene), self.own(batch.scene))

    def widened(self, metres: float) -> ImpactCost | None:
        """Return the cost with hits blurred by a standard deviation [m]; None if the model does not support it."""
        model = self.interaction
        wide = model.widened(metres) if isinstance(model, NativeModel) else None
        return None if wide is None else replace(self, model=wide)

    def kernel(self, scene: Scene, paces: tuple[float, float]) -> ImpactKernel | None:
        """Return the native kernel of this cost, None if there is none; see `NativeModel.kernel`.

        For moving entities it is an approximation; see `MovingModel.kernels`.
        """
        still = self.static_kernel(scene, paces)
        if still is None or not scene.moving:
            return still
        moving = moving_model(self.interaction).kernels(scene, self._moving_severity(scene), paces)
        return None if moving is None else reduce(add, moving, still)

    def static_kernel(self, scene: Scene, paces: tuple[float, float]) -> ImpactKernel | None:
        """Return the native kernel without moving entities, None if there is none; it includes the own loss."""
        model = self.interaction
        return (
            model.kernel(scene, self.severity(scene), paces, self.own(scene))
            if isinstance(model, NativeModel)
            else None
        )

    def moving_impact(self, scene: Scene, *, rough: bool = False) -> _native.MovingImpact:
        """Return the native impact on moving entities as a function of time; `rough` is for descents and searches."""
        return moving_model(self.interaction).impact(scene, self._moving_severity(scene), rough=rough)

    def _moving_severity(self, scene: Scene) -> Float[Array, "component moving"]:
        return self.severity_table(scene)[:, len(scene.entities) : len(scene.entity_names)]

    def is_published(self) -> bool:
        """Tell whether this is the published model, Algorithm 1, which a verdict can recompute independently."""
        return isinstance(self.interaction, BoxOverlap)

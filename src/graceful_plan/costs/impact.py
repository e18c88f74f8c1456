"""Failure impact: who is hit if the robot fails here, times how bad that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.consequence import Damage
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.models.published.box_overlap import BoxOverlap
from graceful_plan.costs.native_model import NativeModel, OwnLoss, moving_model
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


def _struck_itself(scene: Scene) -> Float[Array, " component"]:
    """1 for the component that harms the carried object itself: it is the object."""
    return np.array([float(name == "carried") for name in scene.components])


@final
@dataclass(frozen=True)
class ImpactCost(Cost):
    """I(q) = sum over components and entities, also those that move, of P S.

    P is the probability of a contact, or that of damage, where a hard contact counts more than a soft one. The latter
    has neither gradient nor native kernel: planners fall back to NumPy and do far fewer iterations in the same time.

    One of the entities is the carried object itself, under its own name: S says how bad its loss is (row "carried" of
    the table of severities), P is that its fall damages it, by the height of the fall and by what it comes down on.

    Args:
        model: An interaction model, or the word for one of `MODELS`.
        components: Which parts of the robot count: "body", "carried", "contents"; by default those that the model
            says (`InteractionModel.components`); () for none. Those that a scene does not have contribute nothing.
        consequence: What P is about: "contact"; "energy", damage by the energy of the contact and the shipped table of
            fragilities (`costs.consequence`); or a table of one's own.
        own_loss: Whether the loss of the carried object itself counts, with models that know of it; Algorithm 1 does
            not. By the shipped table of fragilities, or that which `consequence` is.

    Raises:
        UnknownNameError: If there is no such model, component or consequence.
    """

    model: str | InteractionModel = "footprint"
    components: tuple[str, ...] = OF_MODEL
    consequence: str | FragilityTable = "contact"
    own_loss: bool = True

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

    @cached_property
    def interaction(self) -> InteractionModel:
        """The interaction model; where damage counts, one whose probabilities are those of damage."""
        contact = MODELS[self.model]() if isinstance(self.model, str) else self.model
        if self.consequence == "contact":
            return contact
        return Damage(contact, self.fragility)

    def severity(self, scene: Scene) -> Float[Array, "component entity"]:
        """S of each of the scene's components against each entity, zero for components that do not count."""
        counted = self.counted(scene)
        rows = [
            [entity.severity[name] if name in counted else 0.0 for entity in scene.entities.values()]
            for name in scene.components
        ]
        return np.array(rows, dtype=np.float64).reshape(len(scene.components), len(scene.entities))

    def counted(self, scene: Scene) -> tuple[str, ...]:
        """Components that count in a scene: those asked for; if they are the default ones, the body of what drives."""
        drives = scene.base is not None and "body" in scene.components and "body" not in self.components
        return (*self.components, "body") if drives and self._default else self.components

    @property
    def _default(self) -> bool:
        """Whether the components are those of a model that knows how a base fails."""
        model = self.interaction
        return isinstance(model, Footprint) and self.components == model.components

    def counts_own_loss(self, scene: Scene) -> bool:
        """Whether the loss of the carried object itself is one of the hazards."""
        carried = scene.carried is not None and "carried" in self.components
        return self.own_loss and carried and self.interaction.knows_own_loss

    def hazards(self, scene: Scene) -> tuple[str, ...]:
        """Names of all whose harm counts: entities, entities that move, and last the carried object itself."""
        if scene.carried is None or not self.counts_own_loss(scene):
            return scene.hazards
        return (*scene.hazards, scene.carried.body)

    def hazard_severity(self, scene: Scene) -> Float[Array, "component hazard"]:
        """S of each component against each of `hazards`; the object itself is harmed by the component "carried"."""
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

    def probability(self, batch: StateBatch) -> Float[Array, "n component hazard"]:
        """P of each component against each of `hazards`, given a failure at each state."""
        parts, scene = [self.interaction.probability(batch)], batch.scene
        if scene.moving:
            parts.append(np.asarray(sum(moving_model(self.interaction).sources(batch, self.counted(scene)).values())))
        if self.counts_own_loss(scene):
            parts.append(np.asarray(sum(self._own_sources(batch).values())))
        return np.concatenate(parts, axis=2)

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component hazard"]]:
        """Return `probability` by what goes wrong."""
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
        """P that the carried object itself is damaged, by what goes wrong."""
        found, row = self.interaction.own_loss(batch, self.fragility), _struck_itself(batch.scene)
        return {name: P[:, None, None] * row[:, None] for name, P in found.items()}

    @property
    def fragility(self) -> FragilityTable:
        """How easily things are damaged."""
        return FragilityTable.shipped() if isinstance(self.consequence, str) else self.consequence

    def own(self, scene: Scene) -> OwnLoss | None:
        """What the loss of the carried object itself counts in a scene, None if it does not."""
        return OwnLoss(scene.own_severity, self.fragility) if self.counts_own_loss(scene) else None

    def state(self, batch: StateBatch) -> Float[Array, " n"]:
        """Expected severity given a failure at each state."""
        return np.einsum("nce,ce->n", self.probability(batch), self.hazard_severity(batch.scene))

    def gradient(self, batch: StateBatch) -> Float[Array, "n nq"] | None:
        """Derivative of the expected severity with respect to q at constant velocity, None if the model has none."""
        model, scene = self.interaction, batch.scene
        if isinstance(model, NativeModel):
            found = self.gradients(batch)
            return None if found is None else found[0]
        if scene.moving or self.counts_own_loss(scene):
            return None
        return model.gradient(batch, self.severity(scene))

    def gradients(self, batch: StateBatch) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Derivatives with respect to q and to the joint velocities [s/rad], None if the model has none."""
        model = self.interaction
        if batch.scene.moving or not isinstance(model, NativeModel):
            return None
        return model.gradients(batch, self.severity(batch.scene), self.own(batch.scene))

    def widened(self, metres: float) -> ImpactCost | None:
        """Return a cost that smears hits by so much more, None if there is none; see `NativeModel.widened`."""
        model = self.interaction
        wide = model.widened(metres) if isinstance(model, NativeModel) else None
        return None if wide is None else replace(self, model=wide)

    def kernel(self, scene: Scene, paces: tuple[float, float]) -> ImpactKernel | None:
        """Return the native kernel that computes the same, None if there is none; see `NativeModel.kernel`.

        Of entities that move it is only close: see `MovingModel.kernels`.
        """
        still = self.still_kernel(scene, paces)
        if still is None or not scene.moving:
            return still
        moving = moving_model(self.interaction).kernels(scene, self._moving_severity(scene), paces)
        return None if moving is None else reduce(add, moving, still)

    def still_kernel(self, scene: Scene, paces: tuple[float, float]) -> ImpactKernel | None:
        """Return the native kernel of what stands still and of the carried object itself, None if there is none."""
        model = self.interaction
        return (
            model.kernel(scene, self.severity(scene), paces, self.own(scene))
            if isinstance(model, NativeModel)
            else None
        )

    def moving_impact(self, scene: Scene, *, rough: bool = False) -> _native.MovingImpact:
        """Return the part of moving entities at times, in the core; roughly for descents and searches."""
        return moving_model(self.interaction).impact(scene, self._moving_severity(scene), rough=rough)

    def _moving_severity(self, scene: Scene) -> Float[Array, "component moving"]:
        return self.hazard_severity(scene)[:, len(scene.entities) : len(scene.hazards)]

    def is_published(self) -> bool:
        """Whether this is the published model, Algorithm 1, which a verdict can recompute on its own."""
        return isinstance(self.interaction, BoxOverlap)

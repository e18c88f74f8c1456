r"""Probability that a contact does damage, from its energy and the entity's fragility.

The carried object arrives at the height of an entity's top with the kinetic energy

.. math:: E = m g \max(h, 0) + \tfrac{1}{2} m \lVert v \rVert^2

with its mass m, the height h of its lowest point above that top, and the velocity v of its centre of mass at the
failure onset. Only a part of E acts along the contact normal: objects turn, bounce and roll before they touch most
things. With the part :math:`e^{-X}`, X exponential with mean b, and log-normal fragility,

.. math:: P(\mathrm{damage}) = P\left( Z \sigma + X \le a \right)
    = \Phi\left(\frac{a}{\sigma}\right)
    - e^{-\frac{a}{b} + \frac{\sigma^2}{2 b^2}} \, \Phi\left(\frac{a}{\sigma} - \frac{\sigma}{b}\right),
    \qquad a = \ln \frac{E}{E_{50}}

The energy of the body is log-normal, with the same parameters for every failure; a held object that a failing arm
carries into something has the energy of the body. Contents do harm by wetting, whatever their energy.

`FailureMixture` computes this in the native core. `Damage` does so for all other contact models, in NumPy, with the
energy of a drop for the carried object whatever failed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.drop.loss import CARRIED_LOSS, carried_mass
from graceful_plan.costs.models.drop.release import heights, release
from graceful_plan.costs.models.drop.tables import drop_tables, highest_tops
from graceful_plan.costs.models.moving.model import MovingModel
from graceful_plan.costs.native_model import NativeModel, moving_model
from graceful_plan.scene.harm.fragility import Fragility, FragilityTable

BODY_ENERGY = 0.5
"""Median energy of the robot's body [J]. Measured: 0.52 in 641 touches after 5400 severe failures of single drives,
sensors and power along the same motions."""
BODY_SPREAD = 2.5
"""Standard deviation of the logarithm of the body's energy, from the same touches."""

_GRAVITY = 9.81
_KNOTS = 1000  # in each half of a curve; linear interpolation is then accurate to 1e-4


@final
@dataclass(frozen=True)
class Damage(NativeModel):
    """P(component damages entity | failure): P(contact) of a contact model times P(damage | contact). No native kernel.

    Args:
        contact: The contact model.
        fragility: Fragilities of the entities.
    """

    contact: InteractionModel
    fragility: FragilityTable

    @property
    def components(self) -> tuple[str, ...]:
        """Components of the contact model."""
        return self.contact.components

    def probability(self, batch: StateBatch) -> Float[Array, "n component entity"]:
        """Return P(contact) P(damage | contact)."""
        return self.contact.probability(batch) * damage_probability(batch, self.fragility)

    def sources(self, batch: StateBatch) -> Mapping[str, Float[Array, "n component entity"]]:
        """Return the probabilities by source, as resolved by the contact model."""
        damage = damage_probability(batch, self.fragility)
        return {name: share * damage for name, share in self.contact.sources(batch).items()}

    @property
    def knows_own_loss(self) -> bool:
        """Whether the contact model knows the own loss."""
        return self.contact.knows_own_loss

    def own_loss(self, batch: StateBatch, fragility: FragilityTable) -> Mapping[str, Float[Array, " n"]]:
        """Return the own loss of the contact model, which is about damage in any case."""
        return self.contact.own_loss(batch, fragility)

    def moving(self) -> MovingModel:
        """Return that of the contact model: for moving entities, every contact counts."""
        return moving_model(self.contact)

    def fault_shares(self) -> Mapping[str, Mapping[str, float]]:
        """Return the faults behind each source, with their weights."""
        return self.contact.fault_shares()


def damage_probability(batch: StateBatch, table: FragilityTable) -> Float[Array, "n component entity"]:
    """Return P(damage | contact) for a failure at each state, in the scene's order of components and entities."""
    scene = batch.scene
    rows = [table.of(entity.category) for entity in scene.entities.values()]
    P = np.zeros((len(batch), len(scene.components), len(rows)))
    for c, name in enumerate(scene.components):
        for e, row in enumerate(rows):
            if name == "contents":
                P[:, c, e] = row.wetted
            elif name == "body":
                P[:, c, e] = damaged_by_body(row)
        if name == "carried" and len(batch):
            energy = arrival_energy(batch)
            for e, row in enumerate(rows):
                P[:, c, e] = damaged_by_carried(energy[:, e], row)
    return P


def arrival_energy(batch: StateBatch) -> Float[Array, "n entity"]:
    """Compute the kinetic energy E of the carried object at the height of each entity's top, if it is let go [J].

    Raises:
        ShapeError: If nothing is carried.
    """
    batch.object_poses  # noqa: B018  raises for a scene without a carried object
    tables = drop_tables(batch.scene)
    state = release(batch, tables)
    low = heights(state, tables)[0].min(axis=1)
    tops = highest_tops(batch.scene)
    height = np.maximum(low[:, None] - np.where(np.isfinite(tops), tops, np.inf), 0.0)
    return carried_mass(batch.scene) * (_GRAVITY * height + 0.5 * (state.v**2).sum(axis=1)[:, None])


def damaged_by_carried(energy: Float[Array, " n"], fragility: Fragility) -> Float[Array, " n"]:
    """Compute the probability that the carried object does damage if it arrives with the given energies [J]."""
    return np.interp(np.log(np.maximum(energy, np.finfo(float).tiny)), *_curve(fragility), left=0.0)


def damaged_by_body(fragility: Fragility) -> float:
    """Compute the probability that the robot's body does damage when it touches an entity."""
    wider = math.hypot(fragility.spread, BODY_SPREAD)
    return Fragility(fragility.median, fragility.wetted, wider).probability(BODY_ENERGY)


@cache
def _curve(fragility: Fragility) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Probability of damage over the logarithm of the carried object's energy."""
    # NumPy has no normal distribution, and SciPy takes longer to import than this library.
    s, b = fragility.spread, CARRIED_LOSS
    a = np.concatenate([np.linspace(-6.0 * s, 6.0 * s, _KNOTS), 6.0 * s + np.linspace(0.0, 20.0 * b, _KNOTS)[1:]])
    P = [_normal(x / s) - math.exp(_log_normal(x / s - s / b) - x / b + 0.5 * (s / b) ** 2) for x in a.tolist()]
    return a + math.log(fragility.median), np.clip(P, 0.0, 1.0)


def _normal(z: float) -> float:
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


def _log_normal(z: float) -> float:
    return math.log(max(_normal(z), 1e-300))

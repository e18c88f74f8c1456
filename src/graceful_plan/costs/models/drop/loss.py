"""Fragility of the carried object itself, by the surface that it lands on, and of the entities that it hits.

Steps 5 and 6 of the specification, in the docstring of the package, use these numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.models.drop.tables import drop_tables, highest_tops
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

LANDING_LOSS = 0.7
"""b: mean of -ln of the share of the vertical energy that acts along the normal where the object lands. Measured:
0.715 in the first touches of 5400 drops along a motion for each of the 27 bundled tasks; see
benchmarks/results/own_loss.md.
"""
CARRIED_LOSS = 2.0
"""b of step 6: mean of -ln of the share of the energy that acts along the normal of a hit. Measured: 2.06 in 4648
touches of entities other than tables and floors, in 5400 drops along a motion for each of the 27 bundled tasks; see
benchmarks/damage_energy at commit cbf77b38."""
NODES = 2.0 - math.sqrt(2.0), 2.0 + math.sqrt(2.0)
"""Nodes of the two-point Gauss-Laguerre rule: values of -ln of that share, in units of its mean."""
WEIGHTS = 0.25 * (2.0 + math.sqrt(2.0)), 0.25 * (2.0 - math.sqrt(2.0))
"""Weights of the nodes."""
_INDESTRUCTIBLE = 50.0  # ln of an energy per mass beyond any fall


@final
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LossTables:
    """Fragility of the carried object.

    | field    | meaning                                                                         | unit    | shape  |
    |----------|---------------------------------------------------------------------------------|---------|--------|
    | strength | ln of the energy per mass at which landing on a target does damage half the time | ln J/kg | target |
    | spread   | standard deviation of that logarithm                                            |         |        |
    """

    strength: Float[Array, " target"]
    spread: float


@per_scene(most=4)
def loss_tables(scene: Scene, fragility: FragilityTable) -> LossTables:
    """Return the tables of a scene with a carried object; targets as in `DropTables`."""
    assert scene.carried is not None  # tables are only built for a carried object
    own = fragility.of_carried(scene.components["carried"].component_class)
    categories = [entity.category for entity in scene.entities.values()]
    struck = [fragility.of("" if k < 0 else categories[k]) for k in drop_tables(scene).target_entity]
    medians = np.array([own.median / row.hardness for row in struck])
    return LossTables(strength=_strength(medians, carried_mass(scene)), spread=own.spread)


def _strength(median: Float[Array, " n"], mass: float) -> Float[Array, " n"]:
    """Return ln of the energy per mass at which half of the things with these median energies are damaged [ln J/kg]."""
    if mass <= 0.0:
        return np.full(len(median), _INDESTRUCTIBLE)
    return np.minimum(np.log(median / mass), _INDESTRUCTIBLE)


@per_scene(most=4)
def damage_tables(scene: Scene, fragility: FragilityTable) -> Float[Array, "entity 3"]:
    """Return the fragility of each entity towards the carried object.

    Args:
        scene: A scene with a carried object.
        fragility: Fragilities by class.

    Returns:
        Rows of the height of the highest point [m], ln of the energy per mass at which half of the hits do damage
        [ln J/kg], and the inverse of the standard deviation of that logarithm.
    """
    own = [fragility.of(entity.category) for entity in scene.entities.values()]
    strength = _strength(np.array([row.median for row in own]), carried_mass(scene))
    tops = highest_tops(scene)
    return np.column_stack([np.where(np.isfinite(tops), tops, 0.0), strength, [1.0 / row.spread for row in own]])


def carried_mass(scene: Scene) -> float:
    """Return the mass of the carried object and everything attached to it [kg]."""
    assert scene.carried is not None
    return float(scene.shapes.body_subtreemass[scene.shapes.body(scene.carried.body).id])

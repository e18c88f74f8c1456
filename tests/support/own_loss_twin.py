"""Step 5 of the drop model in NumPy: whether a fall damages the carried object; an oracle of the native kernel.

It starts from the result of `landing`. Energies are computed from heights; the kernel computes them from times.
"""

from __future__ import annotations

import math

import numpy as np
from drop_twin import catching

import graceful_plan as gp
from graceful_plan.array_types import Float
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.functions import GRAVITY, box, positive
from graceful_plan.costs.models.drop.landing import LEAST_MASS, fly
from graceful_plan.costs.models.drop.loss import LANDING_LOSS
from graceful_plan.costs.models.drop.release import release
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.scene.harm.fragility import FragilityTable

Array = np.ndarray


def own_loss(
    batch: gp.StateBatch, settings: DropSettings | None = None, fragility: FragilityTable | None = None
) -> Float[Array, " n"]:
    """Return P that the object is damaged, given its release, with shipped constants by default."""
    scene, tables = batch.scene, drop_tables(batch.scene)
    k, size = (settings or DropSettings.shipped()).of(tables.shape_class), tables.size
    if not len(tables.target_height):
        return np.zeros(len(batch))
    bears = _bearable(scene, fragility or FragilityTable.shipped())
    state = release(batch, tables)
    flight, landing = fly(tables, k, state)
    targets = flight.targets
    energy = 0.5 * state.v[:, 2:] ** 2 + GRAVITY * positive(flight.shape.low - targets.top)
    level_damage = targets.sum(flight.F * _damage(energy, *bears))
    leaves = landing.leaving / np.maximum(landing.mass, 1e-300)
    a, b = tables.target_carries.T
    catch = catching(tables, k)
    holds = np.minimum(a, b) > size
    loose, drift = np.zeros((len(batch), 1)), np.zeros((len(batch), 2))
    heights, known, total = np.zeros((len(batch), 1)), np.zeros((len(batch), 1)), level_damage.sum(axis=1)
    for level, first in enumerate(tables.level_start[:-1]):
        here = slice(first, tables.level_start[level + 1])
        x, y = (value[:, here] for value in targets.place(landing.falls_to(k, size, loose, drift)))
        inside = box(x, positive(a[here] + k.catch_margin * size), landing.fall_spread)
        inside *= box(y, positive(b[here] + k.catch_margin * size), landing.fall_spread)
        passed = np.cumprod(1.0 - catch[here] * inside, axis=1)
        arrives = np.concatenate([np.ones_like(loose), passed[:, :-1]], axis=1)
        fallen = heights / (loose + LEAST_MASS) - targets.top[here]
        damage = _damage(GRAVITY * positive(fallen), bears[0][here], bears[1])
        more = np.maximum(damage - known / (loose + LEAST_MASS), 0.0)
        total += (loose * arrives * catch[here] * inside * more * holds[here]).sum(axis=1)
        beside = landing.goes_on(k.carry) + k.drift * size * landing.away[:, level]
        x, y = (value[:, here] for value in targets.place(beside))
        held = box(x, positive(a[here] + k.catch_margin * size), landing.fall_spread)
        held *= box(y, positive(b[here] + k.catch_margin * size), landing.fall_spread)
        falls = np.prod(1.0 - catch[here] * held, axis=1, keepdims=True)
        keep, leaving = passed[:, -1:], landing.leaving[:, level, None] * falls
        loose, drift = loose * keep + leaving, drift * keep + leaving * landing.away[:, level]
        heights = heights * keep + leaving * targets.top[first]
        known = known * keep + falls * leaves[:, level, None] * level_damage[:, level, None]
    return total


def _bearable(scene: gp.Scene, fragility: FragilityTable) -> tuple[Float[Array, " target"], float]:
    """Return the energy per mass at which half are damaged, by target, and the spread of its logarithm."""
    assert scene.carried is not None
    own = fragility.carried[scene.carried.object_class]
    mass = float(scene.model.body_subtreemass[scene.model.body(scene.carried.body).id])
    entities = list(scene.entities.values())
    owner = drop_tables(scene).target_entity
    hardness = [1.0 if k < 0 else fragility.of(entities[k].category).hardness for k in owner.tolist()]
    return own.median / (mass * np.array(hardness)), own.spread


def _damage(energy: Array, bearable: Array, spread: float) -> Array:
    found = np.zeros(np.broadcast_shapes(energy.shape, bearable.shape))
    root = math.sqrt(2.0)
    for node, weight in ((2.0 - root, (2.0 + root) / 4.0), (2.0 + root, (2.0 - root) / 4.0)):
        z = (np.log(energy / bearable) - LANDING_LOSS * node) / spread
        found += weight / (1.0 + np.exp(np.clip(-z * (1.5976 + 0.07056 * z * z), -300.0, 300.0)))
    return found

"""Whom of those who move a base meets that fails, by the coast model: who goes on at the velocity of that moment.

Obstacles and those who stand stop the base before, as everybody else. Where somebody is at the moment of the failure is
uncertain by the spread of the prediction then. Without times, P is the mean over the predicted path.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.moving.drops import mean_over_times, path_times
from graceful_plan.costs.models.moving.outlines import outlines
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.native import coast_model, reals
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_SOON = 1e-3
"""Time over which a velocity is looked at [s]."""


def walkers_met(batch: StateBatch, settings: CoastSettings) -> Float[Array, "n moving"]:
    """Return P that a base that fails in each state meets each moving entity, times what the energy is worth."""
    scene = batch.scene
    P = np.zeros((len(batch), len(scene.moving)))
    if scene.base is None or not P.size:
        return P
    for column, entity in enumerate(scene.moving.values()):
        times = path_times(entity) if batch.time is None else batch.time[:, None]
        times = np.broadcast_to(times, (len(batch), times.shape[-1]))

        def met(who: MovingEntity, state: Int[Array, " pair"], t: Float[Array, " pair"]) -> Float[Array, " pair"]:
            return walker_met(scene, settings, who, (batch.q[state], batch.qd[state], t))

        P[:, column] = mean_over_times(met, entity, times)
    return P


def walker_met(
    scene: Scene,
    settings: CoastSettings,
    entity: MovingEntity,
    states: tuple[Float[Array, "n nq"], Float[Array, "n nq"], Float[Array, " n"]],
) -> Float[Array, " n"]:
    """Return P that one moving entity is met.

    Args:
        scene: With a base that drives.
        settings: How it fails.
        entity: Who.
        states: Configurations, their velocities, and times on the clock of the prediction [s].
    """
    q, qd, t = states
    shape, velocity, spread = seen_from_above(entity, t)
    native = coast_model(scene, settings)
    found = native.met(reals(q), reals(qd), shape=reals(shape), velocity=reals(velocity), spread=reals(spread))
    bottom, top = coast_tables(scene).height
    z, half = entity.at(t).position[:, 2], entity.half_size[2]
    return np.where((z - half < top) & (z + half > bottom), found, 0.0)


def seen_from_above(
    entity: MovingEntity, t: Float[Array, " n"]
) -> tuple[Float[Array, "n 7"], Float[Array, "n 2"], Float[Array, " n"]]:
    """Return outlines of a moving entity at times, as in `CoastTables.shape`, its velocities [m/s] and spreads [m]."""
    there, soon = entity.at(t), entity.at(t + _SOON)
    shape = outlines(entity, there.position[:, :2], there.yaw)
    return shape, (soon.position - there.position)[:, :2] / _SOON, there.spread

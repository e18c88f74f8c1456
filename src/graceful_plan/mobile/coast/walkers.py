"""Whom of those who move a base meets that fails, by the coast model: who goes on at the velocity of that moment.

Obstacles and those who stand stop the base before, as everybody else. Where somebody is at the moment of the failure is
uncertain by the spread of the prediction then. Without times, P is the mean over the predicted path.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.costs.models.moving.drops import moving_table
from graceful_plan.costs.models.moving.outlines import outlines
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.native import coast_model
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_SOON = 1e-3
"""Time over which a velocity is looked at [s]."""


@per_scene(most=4)
def moving_coast(scene: Scene, settings: CoastSettings) -> _native.MovingCoast:
    """Return P that a failing base meets each moving entity, times what its energy is worth."""
    bottom, top = coast_tables(scene).height
    return _native.MovingCoast(moving_table(scene), coast_model(scene, settings), bottom=bottom, top=top)


def seen_from_above(
    entity: MovingEntity, t: Float[Array, " n"]
) -> tuple[Float[Array, "n 7"], Float[Array, "n 2"], Float[Array, " n"]]:
    """Return outlines of a moving entity at times, as in `CoastTables.shape`, its velocities [m/s] and spreads [m]."""
    there, soon = entity.at(t), entity.at(t + _SOON)
    shape = outlines(entity, there.position[:, :2], there.yaw)
    return shape, (soon.position - there.position)[:, :2] / _SOON, there.spread

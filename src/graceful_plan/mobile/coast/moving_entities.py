"""Coast model for moving entities, which continue at the velocity they have at the failure.

Obstacles and standing entities stop the base earlier, as in the static model. The position of a moving entity at the
failure has the spread of its prediction at that time. Without times, P is the mean over the predicted path.
"""

from __future__ import annotations

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.costs.models.moving.drops import moving_table
from graceful_plan.costs.models.moving.outlines import outlines
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.native import coast_model
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

_SOON = 1e-3
"""Interval of the finite difference for velocities [s]."""


@per_scene(most=4)
def moving_coast(scene: Scene, settings: CoastSettings) -> _native.MovingCoast:
    """Return the native model for hits of moving entities by a failing base, weighted by energy."""
    bottom, top = coast_tables(scene).height
    return _native.MovingCoast(moving_table(scene), coast_model(scene, settings), bottom=bottom, top=top)


def planar_shapes(
    entity: MovingEntity, t: Float[Array, " n"]
) -> tuple[Float[Array, "n 7"], Float[Array, "n 2"], Float[Array, " n"]]:
    """Return planar shapes of a moving entity at times, as in `CoastTables`, its velocities [m/s] and spreads [m]."""
    there, soon = entity.at(t), entity.at(t + _SOON)
    shape = outlines(entity, there.position[:, :2], there.yaw)
    return shape, (soon.position - there.position)[:, :2] / _SOON, there.spread

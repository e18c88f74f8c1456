"""Impact of dropping the carried object, by the default model, over a horizontal plane."""

from __future__ import annotations

import numpy as np

from graceful_plan.analysis.gantry import gantry_scene
from graceful_plan.array_types import Array, Float
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import FALLING
from graceful_plan.costs.objective import Objective
from graceful_plan.scene.scene import Scene


def drop_impact(
    scene: Scene, q: Float[Array, " nq"], x: Float[Array, " nx"], y: Float[Array, " ny"]
) -> Float[Array, "ny nx"]:
    """Compute the impact of a drop at every (x, y), with the orientation and height of the carried object at `q`.

    Args:
        scene: Scene with an object in the gripper.
        q: Configuration that determines orientation and height of the object.
        x: Position of the origin of the object's body [m].
        y: Position of the origin of the object's body [m].
    """
    if scene.carried is None:
        return np.zeros((len(y), len(x)))
    data, body = scene.data_at(q), scene.model.body(scene.carried.body).id
    places = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), data.xpos[body, 2])], axis=-1)
    places += data.subtree_com[body] - data.xpos[body]
    gantry = gantry_scene(scene, data.xmat[body].reshape(3, 3))
    impact = Objective(impact=ImpactCost(components=FALLING)).bind(gantry)
    return impact.states(places.reshape(-1, 3)).reshape(len(y), len(x))

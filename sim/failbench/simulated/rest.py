"""Sleep policy of carried objects: they may sleep only after they have left the gripper.

An object that fell asleep in the gripper would stay in the air after its release.
"""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float, Int

PERIOD = 50
"""Steps between checks of the carried object."""
_AWAY = 0.03
"""Distance beyond the held one at which an object counts as out of the gripper [m]."""


def let_sleep(world: World, xpos: Float[Array, "sim body xyz"], policy: Int[Array, "sim tree"]) -> None:
    """Allow carried objects that have left the gripper to sleep, from the next step on.

    Args:
        world: The simulated world.
        xpos: Positions of all bodies in W [m].
        policy: Live sleep policies of each simulation's kinematic trees.
    """
    if world.carried_body < 0:
        return
    model = world.model
    tool = int(model.site(world.scene.tool).bodyid[0])
    held = float(np.linalg.norm(model.eq_data[world.hold, 3:6]))
    distance = np.linalg.norm(xpos[:, world.carried_body] - xpos[:, tool], axis=-1)
    tree = int(model.body_treeid[world.carried_body])
    policy[distance > held + _AWAY, tree] = int(mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED)

"""When a carried object may fall asleep: not before it is out of the hand.

An object that comes to rest in the hand would fall asleep there, and hang in the air when the hand lets go.
"""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.simulated.world import World
from graceful_plan.array_types import Float, Int

Array = np.ndarray

PERIOD = 50
"""Steps from one look at the object to the next."""
_AWAY = 0.03
"""An object that is this much farther from the hand than it was held [m] is out of it for good."""


def let_sleep(world: World, xpos: Float[Array, "sim body xyz"], policy: Int[Array, "sim tree"]) -> None:
    """Let carried objects sleep that are out of the hand, from the next step on; the others stay as they are.

    Args:
        world: Where.
        xpos: Positions of all bodies in W [m].
        policy: Live sleep policy of each simulation's kinematic trees.
    """
    if world.carried_body < 0:
        return
    model = world.model
    tool = int(model.site(world.scene.tool).bodyid[0])
    held = float(np.linalg.norm(model.eq_data[world.hold, 3:6]))
    distance = np.linalg.norm(xpos[:, world.carried_body] - xpos[:, tool], axis=-1)
    tree = int(model.body_treeid[world.carried_body])
    policy[distance > held + _AWAY, tree] = int(mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED)

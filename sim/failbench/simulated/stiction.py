"""Stiction between the fingers and the object that they hold, which MuJoCo's contacts lack.

The friction of MuJoCo's contacts acts against velocities and knows no position, so a held object creeps for two
reasons. The contacts are soft: gravity alone pulls a mug down by 0.03 mm/s. And the position of a free body is
integrated along the tangent while the tool moves on an arc: the object drifts outwards at half a time step times its
centripetal acceleration, by 1 mm/s at 1 m/s^2. Within a minute of motion, a mug slips out of fingers that hold it well.

Here the surfaces of the fingers move like conveyor belts, against the displacement of the object from where it has
stuck. They act by the friction of the contacts alone. An object that moves faster than creep slips; it sticks again
where it stops. Healthy robots are simulated in this way, for minutes; after a failure, the surfaces rest, and an object
that is still held creeps by a millimetre a second.
"""

from __future__ import annotations

import numpy as np
from mujoco.batch import Batch

from failbench.simulated.rest import PERIOD
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float, Int

SURFACE = "geom_surfacevel"
"""The field of MuJoCo's model with the velocity of the surfaces."""
EVERY = PERIOD
"""Steps between two updates."""
_CREEP = 0.02
"""Mean speed between updates below which displacement counts as creep [m/s]; the drift reaches it at 20 m/s^2."""
_RETURN = 2.0
"""Time constant of the return, in times between updates; the displacement decays monotonically above 1."""
_LEVER = 0.03
"""Lever by which rotations count as displacements [m], the order of the distance between fingertips and object."""


class Stiction:
    """Keep held objects where they stick in the fingers, in all simulations of a batch.

    Args:
        world: The simulated world. Without fingers that hold an object by friction, updates do nothing.
        batch: The simulations.
        surface: The batch's values of the field `SURFACE`.
    """

    def __init__(self, world: World, batch: Batch, surface: Float[Array, "sim geom 6"]) -> None:
        holds = world.carried_body >= 0 and world.robot.weld < 0
        self._pads = world.robot.pads if holds else world.robot.pads[:0]
        self._tool = int(world.model.site(world.scene.tool).bodyid[0])
        self._object = world.carried_body
        self._surface, self._seconds = surface, EVERY * world.settings.timestep
        self._xpos, self._xmat, self._geom_xpos, self._geom_xmat = (
            batch.bind(name) for name in ("xpos", "xmat", "geom_xpos", "geom_xmat")
        )
        n = len(surface)
        self._stuck, self._last = np.full((n, 3, 4), np.nan), np.full((n, 3, 4), np.nan)

    def begin(self, sims: Int[Array, " n"]) -> None:
        """Stop the surfaces; objects stick where the next update finds them."""
        self._stuck[sims] = self._last[sims] = np.nan
        self._surface[sims] = 0.0

    def update(self, sims: Int[Array, " n"]) -> None:
        """Set the velocities of the surfaces by the present displacements. Call it every `EVERY` steps."""
        if len(self._pads):
            for sim in sims.tolist():
                self._update(sim)

    def _update(self, sim: int) -> None:
        p_WO, R_WT = self._xpos[sim, self._object], self._xmat[sim, self._tool].reshape(3, 3)
        X_TO = np.empty((3, 4))
        X_TO[:, 3] = R_WT.T @ (p_WO - self._xpos[sim, self._tool])
        X_TO[:, :3] = R_WT.T @ self._xmat[sim, self._object].reshape(3, 3)
        moved, turned = _displacement(self._last[sim], X_TO)
        moving = np.linalg.norm(moved) + _LEVER * np.linalg.norm(turned)
        if not moving <= _CREEP * self._seconds:  # NaN at the first update
            self._stuck[sim] = X_TO
        self._last[sim] = X_TO
        # Velocity v of the object's origin and angular velocity w that bring the object back, in W.
        v, w = (R_WT @ -off / (_RETURN * self._seconds) for off in _displacement(self._stuck[sim], X_TO))
        R_WG = self._geom_xmat[sim, self._pads].reshape(-1, 3, 3)
        at_pads = v + np.cross(w, self._geom_xpos[sim, self._pads] - p_WO)
        self._surface[sim, self._pads, :3] = (at_pads[:, None] @ R_WG)[:, 0]
        self._surface[sim, self._pads, 3:] = w @ R_WG


def _displacement(a: Float[Array, "3 4"], b: Float[Array, "3 4"]) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Return the translation and the rotation vector, which is small, from one pose to another."""
    turn = b[:, :3] @ a[:, :3].T
    skew = 0.5 * (turn - turn.T)
    return b[:, 3] - a[:, 3], skew[[2, 0, 1], [1, 2, 0]]

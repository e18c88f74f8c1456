"""Touches of the healthy robot by moving entities that deviate from their prediction."""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.recording.contact_query import CARRIED, ROBOT, ContactQuery
from failbench.simulated.states import CHECKPOINT
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Bool, Float, Int


class HealthyTouches:
    """The robot of a healthy run, against which poses of moving entities are checked.

    Contacts are searched only at checkpoints where, seen from above, the circle around an entity meets the circle
    around a geom of the robot or the carried object.

    Args:
        world: The simulated world.
        states: MuJoCo's integration state at each checkpoint.
        baseline: Components and entities that touch without a deviation; these entities are not checked.
    """

    def __init__(
        self, world: World, states: Float[Array, "checkpoint state"], baseline: frozenset[tuple[str, str]]
    ) -> None:
        self._world, self._qpos = world, states[:, 1 : 1 + world.model.nq]
        known, names = {entity for _, entity in baseline}, list(world.scene.entities)
        self._walkers = [walker for walker in world.walkers if walker.name not in known]
        self._ids = [names.index(walker.name) for walker in self._walkers]
        query = ContactQuery(world)
        model, data = query.model, query.data
        geoms = np.flatnonzero(np.isin(query.owner, (ROBOT, CARRIED)))
        self._centres = np.empty((len(states), len(geoms), 2))
        for row, qpos in zip(self._centres, self._qpos, strict=True):
            data.qpos = qpos
            mujoco.mj_kinematics(model, data)
            row[:] = data.geom_xpos[geoms, :2]
        self._radii = model.geom_rbound[geoms] + 2.0 * model.geom_margin.max()

    def any(self, rows: Float[Array, "step_and_next mocap"], step: int) -> bool:
        """Return whether an entity touches the robot at a checkpoint.

        Args:
            rows: Poses of the moving entities before each step from `step` on.
            step: First step.
        """
        places = rows[::CHECKPOINT]
        at = np.minimum((step + CHECKPOINT * np.arange(len(places))) // CHECKPOINT, len(self._qpos) - 1)
        near = np.flatnonzero(self._near(places, at))
        if not len(near):
            return False
        query = ContactQuery(self._world)
        for k in near:
            query.place(np.concatenate([self._qpos[at[k]], places[k]]))
            owners = query.owners()
            if (np.isin(owners, self._ids).any(axis=1) & np.isin(owners, (ROBOT, CARRIED)).any(axis=1)).any():
                return True
        return False

    def _near(self, places: Float[Array, "place mocap"], at: Int[Array, " place"]) -> Bool[Array, " place"]:
        """Return at which checkpoints circles meet, so that there may be a touch."""
        near, model = np.zeros(len(places), dtype=bool), self._world.model
        for walker in self._walkers:
            slot = int(model.body_mocapid[model.body(walker.name).id])
            radius = walker.size[0] if walker.is_round else np.hypot(*walker.size[:2])
            offset = self._centres[at] - places[:, None, 3 * slot : 3 * slot + 2]
            near |= (np.linalg.norm(offset, axis=2) <= self._radii + radius).any(axis=1)
        return near

"""Final state of a rollout: objects that fell, tipped over, left their support or were dropped."""

from __future__ import annotations

from typing import Any

import numpy as np

from failbench.recording.bounds import Bounds
from failbench.recording.contact_query import ContactQuery
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float, Int

FALLEN = 0.05
"""Descent of both an entity's body origin and its lowest point above which it counts as fallen [m]. An entity that only
fell over has not fallen."""
TIPPED = np.deg2rad(30.0)
"""Angle between the vertical and the initially vertical direction above which an entity counts as tipped [rad]."""
MOVED = 1e-3
"""Displacement [m] and tilt [rad] up to which an entity counts as still on its support."""
DROPPED = 0.03
"""Displacement in the tool frame above which a carried object that touches no finger counts as dropped [m]."""


class FinalState:
    """Compare the end of a simulation with its beginning.

    Args:
        world: The simulated world.
        closeup: Contact queries for single states.
        bounds: Boxes around the entities.
    """

    def __init__(self, world: World, closeup: ContactQuery, bounds: Bounds) -> None:
        self._world = world
        self._closeup = closeup
        self._bounds = bounds
        self._names = list(world.movable)
        free = [*world.movable.values(), *([world.carried_body] if world.carried_body >= 0 else [])]
        adr = world.model.jnt_qposadr[world.model.body_jntadr[free]].astype(int)
        self._poses = adr[:, None] + np.array([3, 4, 5, 6, 0, 1, 2])
        self._strikers = {body for bodies in world.striker_bodies.values() for body in bodies}
        self._pads = {int(world.model.geom_bodyid[g]) for g in world.robot.pads}
        self._tool = int(world.model.site(world.scene.tool).id)

    def fields(self, before: Float[Array, " qpos"], after: Float[Array, " qpos"]) -> dict[str, Any]:
        """Return the fields fell, tipped, left_support, dropped and poses of a Rollout."""
        was, became = before[self._poses], after[self._poses]
        n = len(self._names)
        shift = became[:n, 4:] - was[:n, 4:]
        tilt = _tilt(was[:n], became[:n])
        fell = shift[:, 2] < -FALLEN
        if fell.any():
            fell &= self._bounds.lowest(after) - self._bounds.lowest(before) < -FALLEN
        moved = np.flatnonzero((np.abs(shift) > MOVED).any(axis=1) | (tilt > MOVED))
        (stood, place), (stands, end) = self._look(before), self._look(after)
        left = [self._names[i] for i in moved if self._lost(self._names[i], stood, stands)]
        out_of_place = place is not None and end is not None and bool(np.linalg.norm(end - place) > DROPPED)
        carried = self._world.striker_bodies.get("carried", ())
        poses = dict(zip([*self._names, "carried"], became, strict=False))
        return {
            "fell": tuple(self._names[i] for i in np.flatnonzero(fell)),
            "tipped": tuple(self._names[i] for i in np.flatnonzero(tilt > TIPPED)),
            "left_support": tuple(left),
            "dropped": out_of_place and not _neighbours(stands, carried) & self._pads,
            "poses": poses,
        }

    def _look(self, qpos: Float[Array, " qpos"]) -> tuple[Int[Array, "contact 2"], Float[Array, " xyz"] | None]:
        """Return the bodies of all contacts, and the position of the carried object in the tool frame [m]."""
        self._closeup.place(qpos)
        pairs = self._closeup.bodies()
        if self._world.carried_body < 0:
            return pairs, None
        data = self._closeup.data
        R_WT, p_WT = data.site_xmat[self._tool].reshape(3, 3), data.site_xpos[self._tool]
        return pairs, R_WT.T @ (data.xpos[self._world.carried_body] - p_WT)

    def _lost(self, name: str, stood: Int[Array, "contact 2"], stands: Int[Array, "later 2"]) -> bool:
        """Return whether an entity has lost all contacts it had, except with the robot."""
        own = self._world.entity_bodies[name]
        support = _neighbours(stood, own) - self._strikers
        return bool(support) and not support & _neighbours(stands, own)


def _neighbours(pairs: Int[Array, "contact 2"], bodies: tuple[int, ...]) -> set[int]:
    """Return the other bodies that touch any of `bodies`."""
    found: set[int] = set()
    for body in bodies:
        found.update(pairs[pairs[:, 0] == body, 1].tolist(), pairs[pairs[:, 1] == body, 0].tolist())
    return found.difference(bodies)


def _tilt(before: Float[Array, "body 7"], after: Float[Array, "body 7"]) -> Float[Array, " body"]:
    """Return the angle [rad] between the vertical and the direction in the body that was vertical before."""
    a, b = (_up(pose[:, :4]) for pose in (before, after))
    # Accurate near 0, unlike the arc cosine.
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))


def _up(quat: Float[Array, "body wxyz"]) -> Float[Array, "body xyz"]:
    """Return the vertical in the body frames."""
    w, x, y, z = quat.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)

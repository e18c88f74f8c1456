"""Contact queries for single states of a simulation: which things touch, how fast, and with what effective mass."""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from failbench.simulated.moving_entities import set_entity_poses
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float, Int

NOBODY, ROBOT, CARRIED, OBSTACLE = -1, -2, -3, -4
"""Owners of geoms other than entities; entities are numbered from 0."""


class FirstTouch(NamedTuple):
    """First touch of two things, seen from the striker."""

    position: Float[Array, " xyz"]
    """Mean contact position, in W [m]."""
    speed: float
    """Approach speed along the mean normal [m/s], >= 0."""
    energy: float
    """Kinetic energy of the striker along that normal [J]: half its effective mass at the position times speed^2."""


class _Contacts(NamedTuple):
    """Contacts between a body of the striker and a body of the struck thing."""

    striker: int
    struck: int
    position: Float[Array, " xyz"]
    normal: Float[Array, " xyz"]


class ContactQuery:
    """An MjData that is set to single states to query their contacts. Positions are in W.

    Args:
        world: The simulated world. Its model is copied with sleep disabled, since contacts of sleeping bodies are
            skipped.
    """

    def __init__(self, world: World) -> None:
        self.model = copy.copy(world.model)
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        self.data = mujoco.MjData(self.model)
        self.entities = tuple(world.scene.entities)
        self.owner = _owners(world)
        self._body = self.model.geom_bodyid.copy()
        self._walking = np.zeros((self.model.nmocap, 3))
        self._jacobians = np.zeros((2, 3, self.model.nv))

    def place(self, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"] | None = None) -> None:
        """Set the state, at rest if no velocities are given, and find all contacts.

        Args:
            qpos: Positions, optionally followed by poses of the moving entities; without these, they stay where they
                were.
            qvel: Velocities, optionally followed by those of the moving entities.
        """
        nq, nv = self.model.nq, self.model.nv
        self.data.qpos = qpos[:nq]
        self.data.qvel = 0.0 if qvel is None else qvel[:nv]
        if len(qpos) > nq:
            set_entity_poses(self.model, self.data, qpos[nq:])
        self._walking[:] = 0.0 if qvel is None or len(qvel) == nv else qvel[nv:].reshape(-1, 3)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)

    def owners(self) -> Int[Array, "contact 2"]:
        """Return the owners of the geoms of each contact."""
        return self.owner[self.data.contact.geom]

    def bodies(self) -> Int[Array, "contact 2"]:
        """Return the bodies of the geoms of each contact."""
        return self._body[self.data.contact.geom]

    def normal(self, striker: int, struck: int) -> Float[Array, " xyz"] | None:
        """Return the mean direction of the contacts from one owner to another; None if they do not touch."""
        contacts = self._between(striker, struck)
        return None if contacts is None else contacts.normal

    def touch(self, striker: int, struck: int) -> FirstTouch | None:
        """Return the first touch of two owners, for a state in which they just met; None if they do not touch."""
        contacts = self._between(striker, struck)
        if contacts is None:
            return None
        model, data = self.model, self.data
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_factorM(model, data)
        own, other = self._jacobians
        mujoco.mj_jac(model, data, own, None, contacts.position, contacts.striker)
        mujoco.mj_jac(model, data, other, None, contacts.position, contacts.struck)
        # MuJoCo's normals of a new contact may point either way; the two things do approach.
        walker = int(model.body_mocapid[contacts.struck])
        own_walk = self._walking[walker] if walker >= 0 else np.zeros(3)
        speed = abs(float(contacts.normal @ ((own - other) @ data.qvel - own_walk)))
        along = contacts.normal @ own
        response = np.zeros((1, model.nv))
        mujoco.mj_solveM(model, data, response, along[None])
        inverse_mass = float(along @ response[0])
        return FirstTouch(contacts.position, speed, 0.5 * speed**2 / inverse_mass if inverse_mass > 0.0 else 0.0)

    def _between(self, striker: int, struck: int) -> _Contacts | None:
        """Return the contacts of two owners; with several pairs of bodies, those of the deepest pair."""
        found: list[tuple[int, int, int, float]] = []
        for i, (a, b) in enumerate(self.owners().tolist()):
            if (a, b) == (striker, struck):
                found.append((i, 0, 1, 1.0))
            elif (b, a) == (striker, struck):
                found.append((i, 1, 0, -1.0))
        if not found:
            return None
        contact, bodies = self.data.contact, self.bodies().tolist()
        deepest = min(found, key=lambda f: contact.dist[f[0]])
        pair = bodies[deepest[0]][deepest[1]], bodies[deepest[0]][deepest[2]]
        same = [f for f in found if (bodies[f[0]][f[1]], bodies[f[0]][f[2]]) == pair]
        mean = np.add.reduce([sign * contact.frame[i, :3] for i, _, _, sign in same])
        length = float(np.sqrt(mean @ mean))
        normal = mean / length if length > 1e-6 else deepest[3] * contact.frame[deepest[0], :3]
        position = np.add.reduce([contact.pos[i] for i, *_ in same]) / len(same)
        return _Contacts(*pair, position, normal)


def _owners(world: World) -> Int[Array, " geom"]:
    owner = np.full(world.model.ngeom, NOBODY)
    owner[np.isin(world.model.geom_bodyid, world.obstacles)] = OBSTACLE
    for i, entity in enumerate(world.scene.entities.values()):
        owner[list(entity.geoms)] = i
    for name, number in (("body", ROBOT), ("carried", CARRIED)):
        if name in world.scene.components:
            owner[list(world.scene.components[name].geoms)] = number
    return owner

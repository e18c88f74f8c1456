"""A second look at single states of a simulation: what touches what, how fast, and with how much mass behind it."""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from failbench.world import World
from graceful_plan.array_types import Bool, Float, Int

Array = np.ndarray

NOBODY, ROBOT, CARRIED = -1, -2, -3
"""Owners of geoms besides the entities, which are numbered from 0."""


class Touch(NamedTuple):
    """Two things that touch, seen from the one that strikes."""

    position: Float[Array, " xyz"]
    """Middle of their contacts, in W [m]."""
    normal: Float[Array, " xyz"]
    """Mean direction from the striker to what it strikes."""
    speed: float
    """How fast they approach along the normal [m/s], >= 0."""
    mass: float
    """Effective mass of the striker at the position along the normal [kg]."""

    @property
    def energy(self) -> float:
        """Kinetic energy of the striker along the normal [J]."""
        return 0.5 * self.mass * self.speed**2


class Closeup:
    """One MjData that is set to a state and asked about it. Positions are in W.

    Args:
        world: Where. Its model is copied, without sleeping: what sleeps there would not be looked at here.
    """

    def __init__(self, world: World) -> None:
        self.model = copy.copy(world.model)
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        self.data = mujoco.MjData(self.model)
        self.entities = tuple(world.scene.entities)
        self.owner = _owners(world)

    def place(self, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"]) -> None:
        """Set the state and find all contacts."""
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)

    def touching(self) -> set[tuple[int, int]]:
        """Return the owners of what touches, each pair once with the lower number first."""
        owners = np.sort(self.owner[self._geoms()], axis=1)
        return {(int(a), int(b)) for a, b in owners if a != b}

    def bodies_touching(self) -> set[tuple[int, int]]:
        """Return the bodies of all contacts, each pair in both orders."""
        bodies = self.model.geom_bodyid[self._geoms()]
        return {(int(a), int(b)) for a, b in bodies} | {(int(b), int(a)) for a, b in bodies}

    def touch(self, striker: int, struck: int) -> Touch | None:
        """Return how one owner touches another; None if it does not.

        Where several pairs of bodies touch, the deepest contact says which pair is meant.
        """
        geoms = self._geoms()
        owners = self.owner[geoms]
        ahead = (owners == (striker, struck)).all(axis=1)
        found = np.flatnonzero(ahead | (owners == (struck, striker)).all(axis=1))
        if not len(found):
            return None
        contact = self.data.contact
        bodies = np.where(ahead[:, None], self.model.geom_bodyid[geoms], self.model.geom_bodyid[geoms[:, ::-1]])
        pair = bodies[found[np.argmin(contact.dist[found])]]
        found = found[(bodies[found] == pair).all(axis=1)]
        normal = np.where(ahead[found, None], 1.0, -1.0) * contact.frame[found, :3]
        mean = normal.mean(axis=0)
        length = float(np.linalg.norm(mean))
        normal = mean / length if length > 1e-6 else normal[0]
        return self._touch(contact.pos[found].mean(axis=0), normal, int(pair[0]), int(pair[1]))

    def _geoms(self) -> Int[Array, "contact 2"]:
        return self.data.contact.geom

    def _touch(self, position: Float[Array, " xyz"], normal: Float[Array, " xyz"], striker: int, struck: int) -> Touch:
        model, data = self.model, self.data
        mujoco.mj_comPos(model, data)
        jac, other = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jac, None, position, striker)
        mujoco.mj_jac(model, data, other, None, position, struck)
        speed = float(normal @ (jac - other) @ data.qvel)
        along = (normal @ jac)[None]
        mujoco.mj_makeM(model, data)
        mujoco.mj_factorM(model, data)
        response = np.zeros_like(along)
        mujoco.mj_solveM(model, data, response, along)
        inverse_mass = float(along[0] @ response[0])
        return Touch(position, normal, max(speed, 0.0), 1.0 / inverse_mass if inverse_mass > 0.0 else 0.0)


def _owners(world: World) -> Int[Array, " geom"]:
    owner = np.full(world.model.ngeom, NOBODY)
    for i, entity in enumerate(world.scene.entities.values()):
        owner[list(entity.geoms)] = i
    for name, number in (("body", ROBOT), ("carried", CARRIED)):
        if name in world.scene.components:
            owner[list(world.scene.components[name].geoms)] = number
    return owner


def bodies_of(world: World, name: str) -> Bool[Array, " body"]:
    """Return which bodies are those of a component."""
    mask = np.zeros(world.model.nbody, dtype=bool)
    mask[list(world.striker_bodies.get(name, ()))] = True
    return mask

"""Bounding boxes of entities, to find quickly which of them cannot touch."""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.simulated.world import World
from graceful_plan.array_types import Array, Bool, Float, Int

_ANYWHERE = 1e6
"""Half size of a box that contains everything [m]."""


class Bounds:
    """Axis-aligned boxes around a world's entities. Movable entities are numbered by their order in `world.movable`.

    The box of an entity with moving parts, or of one moved by something else, contains everything.
    """

    def __init__(self, world: World) -> None:
        model = world.model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        names = list(world.scene.entities)
        self._entity = np.array([names.index(name) for name in world.movable], dtype=int)
        joints = model.body_jntadr[list(world.movable.values())]
        self._adr = model.jnt_qposadr[joints].astype(int)
        self._centre, self._half = np.zeros((len(names), 3)), np.zeros((len(names), 3))
        for i, name in enumerate(names):
            self._centre[i], self._half[i] = _box(world, data, name)
        self._slot = np.full(len(names), -1)
        self._slot[self._entity] = np.arange(len(self._entity))
        self._reach = np.linalg.norm(self._centre, axis=1) + np.linalg.norm(self._half, axis=1)

    def overlap(
        self,
        qpos: Float[Array, "sim step qpos"],
        sims: Int[Array, " n"],
        steps: Int[Array, " n"],
        movers: Int[Array, " n"],
        known: Bool[Array, "sim entity entity"],
    ) -> Int[Array, "found 4"]:
        """Return pairs of entities that may touch and are not `known`, as simulation, step, moving entity, other."""
        places = qpos[sims[:, None, None], steps[:, None, None], self._adr[:, None] + np.arange(3)]
        centre = np.repeat(self._centre[None], len(sims), axis=0)
        centre[:, self._entity] = places
        gap = np.abs(places[np.arange(len(sims)), movers][:, None] - centre)
        fixed = self._slot < 0
        room = np.where(fixed[:, None], self._half, self._reach[:, None])
        near = (gap <= self._reach[self._entity[movers]][:, None, None] + room).all(axis=2)
        near &= ~known[sims, self._entity[movers]]
        row, other = np.nonzero(near)
        state = qpos[sims[row], steps[row]]
        own = self._entity[movers[row]]
        (c0, h0), (c1, h1) = self._boxes(state, own), self._boxes(state, other)
        close = (np.abs(c0 - c1) <= h0 + h1).all(axis=1)
        return np.stack([sims[row], steps[row], own, other], axis=1)[close]

    def lowest(self, qpos: Float[Array, " qpos"]) -> Float[Array, " mover"]:
        """Return the height of the lowest point of each movable entity's box [m]."""
        centre, half = self._boxes(np.repeat(qpos[None], len(self._entity), axis=0), self._entity)
        return centre[:, 2] - half[:, 2]

    def _boxes(
        self, qpos: Float[Array, "n qpos"], entity: Int[Array, " n"]
    ) -> tuple[Float[Array, "n xyz"], Float[Array, "n xyz"]]:
        """Return centres and half sizes in W [m]."""
        centre, half = self._centre[entity], self._half[entity]
        moves = np.flatnonzero(self._slot[entity] >= 0)
        adr = self._adr[self._slot[entity[moves]]]
        pose = qpos[moves[:, None], adr[:, None] + np.arange(7)]
        R = rotations(pose[:, 3:])
        centre[moves] = pose[:, :3] + np.einsum("nij,nj->ni", R, centre[moves])
        half[moves] = np.einsum("nij,nj->ni", np.abs(R), half[moves])
        return centre, half


def rotations(quat: Float[Array, "*batch wxyz"]) -> Float[Array, "*batch 3 3"]:
    """Return rotation matrices of unit quaternions."""
    w, x, y, z = np.moveaxis(quat, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _box(world: World, data: mujoco.MjData, name: str) -> tuple[Float[Array, " xyz"], Float[Array, " xyz"]]:
    """Return centre and half sizes of an entity's box [m], in its body frame if it is movable, else in W."""
    model = world.model
    geoms = list(world.scene.entities[name].geoms)
    R, p = data.geom_xmat[geoms].reshape(-1, 3, 3), data.geom_xpos[geoms]
    if name in world.movable:
        body = world.movable[name]
        if world.entity_bodies[name] != (body,):
            return np.zeros(3), np.full(3, _ANYWHERE)
        R_WB = data.xmat[body].reshape(3, 3)
        R, p = np.einsum("ji,gjk->gik", R_WB, R), (p - data.xpos[body]) @ R_WB
    elif model.body_weldid[list(world.entity_bodies[name])].any():
        return np.zeros(3), np.full(3, _ANYWHERE)
    centre = p + np.einsum("gij,gj->gi", R, model.geom_aabb[geoms, :3])
    half = np.einsum("gij,gj->gi", np.abs(R), _half_sizes(model, geoms))
    low, high = (centre - half).min(axis=0), (centre + half).max(axis=0)
    return (low + high) / 2.0, (high - low) / 2.0


def _half_sizes(model: mujoco.MjModel, geoms: list[int]) -> Float[Array, "geom xyz"]:
    """Return half sizes of geoms in their own frames [m]; a plane fills the half-space below it."""
    half = model.geom_aabb[geoms, 3:].copy()
    half[model.geom_type[geoms] == int(mujoco.mjtGeom.mjGEOM_PLANE)] = _ANYWHERE
    return half

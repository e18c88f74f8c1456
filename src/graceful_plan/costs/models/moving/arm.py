"""Whom a collapsing arm reaches: a rule of thumb that was never fitted."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.functions import step
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray

BODY_REACH, BODY_SPREAD = 0.15, 0.1
"""How far from the links a collapsing arm reaches somebody, and how uncertain that is [m]."""
_SIDE_SOFT = 0.02  # how sharply a link passes below somebody [m]


def moving_spheres(batch: StateBatch) -> tuple[Float[Array, "n sphere 3"], Float[Array, " sphere"]]:
    """Return centres and radii of the covering spheres of links that move, and of what they carry [m]."""
    robot = batch.compiled.robot
    moves = np.flatnonzero(robot.sphere_link != 0)
    poses, sphere = batch.link_poses[:, robot.sphere_link[moves]], robot.sphere[moves]
    centre = np.einsum("nsij,sj->nsi", poses[..., :3, :3], sphere[:, :3]) + poses[..., :3, 3]
    return centre, sphere[:, 3]


def near_links(
    batch: StateBatch, entity: MovingEntity, state: Int[Array, " pair"], time: Float[Array, " pair"]
) -> Float[Array, " pair"]:
    """P that a collapsing arm reaches an entity: a rule of thumb, from the nearest sphere of a link that moves."""
    centre, radii = moving_spheres(batch)
    P = np.zeros(len(state))
    there = entity.at(time)
    turn = np.stack([np.cos(there.yaw), np.sin(there.yaw)], axis=-1)[:, None]
    spread = np.hypot(BODY_SPREAD, there.spread)
    for s in range(0, len(radii), 16):  # a few spheres at a time, to bound memory
        here = centre[:, s : s + 16][state]
        away = here - there.position[:, None]
        x = (away[..., :2] * turn).sum(axis=-1)
        y = away[..., 1] * turn[..., 0] - away[..., 0] * turn[..., 1]
        if entity.is_round:
            distance = np.maximum(np.hypot(x, y) - entity.size[0], 0.0)
        else:
            a, b = entity.half_size[:2]
            distance = np.hypot(np.maximum(np.abs(x) - a, 0.0), np.maximum(np.abs(y) - b, 0.0))
        radius = radii[s : s + 16]
        reached = step((radius + BODY_REACH - distance) / spread[:, None])
        above = step((away[..., 2] + radius + entity.half_size[2]) / _SIDE_SOFT)
        np.maximum(P, (reached * above).max(axis=1), out=P)
    return P

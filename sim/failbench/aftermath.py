"""What is left when the dust has settled: things that fell, tipped, left their support or were dropped."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from failbench.closeup import Closeup
from failbench.world import World
from graceful_plan.array_types import Float

Array = np.ndarray

FALLEN = 0.05
"""An entity whose body's origin ended farther below where it was [m] has fallen."""
TIPPED = np.deg2rad(30.0)
"""An entity of which the direction that was up is farther off the vertical [rad] has tipped."""
MOVED = 1e-3
"""An entity that is nearer to where it was [m], and as nearly upright [rad], stands on what it stood on."""
DROPPED = 0.03
"""A carried object that is farther from where it was in the tool frame [m] and free of the fingers is dropped."""


def aftermath(
    world: World, closeup: Closeup, qpos: tuple[Float[Array, " qpos"], Float[Array, " qpos"]]
) -> dict[str, Any]:
    """Compare the positions at the end with those at the onset.

    Returns:
        The fields fell, tipped, left_support, dropped and poses of a Rollout.
    """
    before, after = ({name: _pose(world, q, body) for name, body in world.movable.items()} for q in qpos)
    sunk = {name: before[name][6] - after[name][6] for name in before}
    tilt = {name: _tilt(before[name], after[name]) for name in before}
    moved = [
        name for name in before if np.linalg.norm(after[name][4:] - before[name][4:]) > MOVED or tilt[name] > MOVED
    ]
    poses = after if world.carried_body < 0 else after | {"carried": _pose(world, qpos[1], world.carried_body)}
    return {
        "fell": tuple(name for name in before if sunk[name] > FALLEN),
        "tipped": tuple(name for name in before if tilt[name] > TIPPED),
        "left_support": _left_support(world, closeup, qpos, moved),
        "dropped": world.carried_body >= 0 and _dropped(world, closeup, qpos),
        "poses": MappingProxyType(poses),
    }


def _pose(world: World, qpos: Float[Array, " qpos"], body: int) -> Float[Array, " 7"]:
    """Return the pose of a free body, wxyz_xyz in W."""
    adr = int(world.model.jnt_qposadr[world.model.body_jntadr[body]])
    return np.concatenate([qpos[adr + 3 : adr + 7], qpos[adr : adr + 3]])


def _tilt(before: Float[Array, " 7"], after: Float[Array, " 7"]) -> float:
    """Return the angle [rad] between the vertical and the direction in the body that was vertical before."""
    up = np.array([0.0, 0.0, 1.0])
    inverse = np.zeros(4)
    mujoco.mju_negQuat(inverse, before[:4])
    mujoco.mju_rotVecQuat(up, up.copy(), inverse)
    mujoco.mju_rotVecQuat(up, up.copy(), after[:4])
    return float(np.arctan2(np.hypot(up[0], up[1]), up[2]))


def _left_support(world: World, closeup: Closeup, qpos: tuple[Array, Array], moved: list[str]) -> tuple[str, ...]:
    """Return which of the entities that moved touch nothing any more of what they touched, the robot aside."""
    if not moved:
        return ()
    still = np.zeros(world.model.nv)
    touching: list[set[tuple[int, int]]] = []
    for q in qpos:
        closeup.place(q, still)
        touching.append(closeup.bodies_touching())
    strikers = {body for bodies in world.striker_bodies.values() for body in bodies}
    left = []
    for name in moved:
        own = set(world.entity_bodies[name])
        stood, stands = ({b for a, b in pairs if a in own} - own - strikers for pairs in touching)
        if stood and not stood & stands:
            left.append(name)
    return tuple(left)


def _dropped(world: World, closeup: Closeup, qpos: tuple[Array, Array]) -> bool:
    places = []
    still = np.zeros(world.model.nv)
    for q in qpos:
        closeup.place(q, still)
        site = closeup.data.site(world.scene.tool)
        places.append(site.xmat.reshape(3, 3).T @ (closeup.data.xpos[world.carried_body] - site.xpos))
    if np.linalg.norm(places[1] - places[0]) <= DROPPED:
        return False
    pads = {int(world.model.geom_bodyid[g]) for g in world.robot.pads}
    carried = set(world.striker_bodies["carried"])
    return not any(a in carried and b in pads for a, b in closeup.bodies_touching())

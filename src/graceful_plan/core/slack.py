"""How far the spheres of two links may overlap before the links touch.

Spheres stick out of what they cover. Where two links pass each other at a finger's breadth whatever the joints do, as
those on both sides of a short one, their spheres overlap although the links never touch, and little or nothing would be
free. For such pairs exact geometry looks at many configurations: they count as touching from the largest clearance of
spheres on at which they were found to. That is an estimate, where the spheres themselves are a bound: the judge does
not use it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from hashlib import blake2b
from threading import Lock

import mujoco
import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.core.arrays import HazardArrays, RobotArrays, WorldArrays
from graceful_plan.core.kernels import Kernels
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_SAMPLES, _SAMPLES_OF_MESHES, _FIRST = 4000, 16_000, 256
"""Configurations, drawn evenly within the limits; so many tell whether the rest has to be looked at."""
_EXACT = 500
"""Of those in which the spheres of a pair overlap, how many exact geometry looks at."""
_LOST, _LOST_OF_MESHES = 0.1, 0.003
"""Share of the configurations in which a pair is apart that its spheres may call touching without any slack. Robots of
meshes have dozens of pairs whose spheres stick out everywhere; at .1, UR arms were called free in four of five of the
configurations in which they are, a Fetch with 66 pairs at .01 in 95 %, at .003 in 96 %."""
_RESERVE = 0.0005
"""Kept to what was found [m]."""
_NEVER = 0.003
"""Kept to the deepest overlap where links never touched [m]."""
_KEPT = 4096
"""Pairs whose slack is remembered."""
_known: OrderedDict[bytes, float] = OrderedDict()
_lock = Lock()


def self_slack(
    scene: Scene,
    robot: RobotArrays,
    geoms: Sequence[Sequence[tuple[int, int]]],
    hazards: HazardArrays,
) -> Float[Array, " pair"]:
    """Return the clearance of spheres at which the links of each pair touch [m], at most 0.

    Args:
        scene: Where.
        robot: Tables with pairs of links.
        geoms: The geoms of each pair that may touch.
        hazards: Of the scene.
    """
    slack = np.zeros(len(robot.self_pair))
    for k, (pair, touchable) in enumerate(zip(robot.self_pair, geoms, strict=True)):
        if pair[0] != pair[1]:  # else it is a base that touches something, and never free
            key = _key(robot, pair)
            with _lock:
                known = _known.get(key)
            slack[k] = _slack(scene, robot, pair, touchable, hazards) if known is None else known
            with _lock:
                _known[key] = float(slack[k])
                while len(_known) > _KEPT:
                    _known.popitem(last=False)
    return slack


def _key(robot: RobotArrays, pair: Int[Array, " 2"]) -> bytes:
    """Return what the slack of a pair depends on: its spheres, and how its links move against each other.

    Joints that carry both of them make no difference: how far a base may drive is another matter in each scene.
    """
    frames = len(robot.lower) + 1
    own = np.ones(frames, dtype=bool)
    first, second = (_carriers(robot, link) for link in pair.tolist())
    own[sorted(first & second)] = False
    parts = [robot.lower[own[1:]], robot.upper[own[1:]], robot.X_PL[:frames][own], own]
    parts += [x[:frames] for x in (robot.parent, robot.joint, robot.slide)]
    parts += [robot.sphere[robot.sphere_link == link] for link in pair] + [robot.parent[pair]]
    key = blake2b(digest_size=16)
    for part in parts:
        key.update(np.ascontiguousarray(part).tobytes())
    return key.digest()


def _carriers(robot: RobotArrays, link: int) -> set[int]:
    """Return the frames that a link moves with, its own among them."""
    frames, frame = {0}, int(robot.parent[link])
    while frame > 0:
        frames.add(frame)
        frame = int(robot.parent[frame])
    return frames


def _slack(
    scene: Scene,
    robot: RobotArrays,
    pair: Int[Array, " 2"],
    geoms: Sequence[tuple[int, int]],
    hazards: HazardArrays,
) -> float:
    kernels = Kernels(replace(robot, self_pair=pair[None], self_slack=np.zeros(1)), WorldArrays.nothing(), hazards)
    of_meshes = any(scene.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH for both in geoms for geom in both)
    samples, most = (_SAMPLES_OF_MESHES, _LOST_OF_MESHES) if of_meshes else (_SAMPLES, _LOST)
    drawn = np.random.default_rng(0).uniform(robot.lower, robot.upper, (samples, len(robot.lower)))
    if np.mean(kernels.clearance(drawn[:_FIRST]) < 0.0) < most:
        return 0.0
    clearance = kernels.clearance(drawn)
    overlap = np.flatnonzero(clearance < 0.0)
    chosen = overlap[:_EXACT]
    place = Placement(scene).place
    touch = np.array([_touches(scene.model, place(q), geoms) for q in drawn[chosen]], dtype=bool)
    lost = float(np.mean(~touch)) * len(overlap) if len(chosen) else 0.0
    if lost <= most * (lost + len(drawn) - len(overlap)):
        return 0.0
    if not touch.any():
        return min(0.0, float(clearance.min()) - _NEVER)
    return min(0.0, float(clearance[chosen][touch].max()) + _RESERVE)


def _touches(model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[tuple[int, int]]) -> bool:
    return any(mujoco.mj_geomDistance(model, data, a, b, _NEVER, None) <= 0.0 for a, b in geoms)

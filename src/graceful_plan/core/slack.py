"""Estimate the overlap of two links' spheres at which the links touch.

Spheres stick out of the geoms they cover. If two links pass within a finger's breadth of each other in all
configurations, such as those on both sides of a short link, their spheres overlap although the links never touch, and
few or no configurations would be free. For such pairs, exact geometry checks many configurations. The slack is the
largest clearance of spheres at which the links touched. It is an estimate, whereas the spheres are a bound; the judge
does not use it.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from hashlib import blake2b
from threading import Lock

import mujoco
import numpy as np

from graceful_plan import disk_cache
from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.arrays import ImpactArrays, RobotArrays, WorldArrays
from graceful_plan.core.kernels import Kernels
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

_SAMPLES, _SAMPLES_OF_MESHES, _FIRST = 4000, 16_000, 256
"""Numbers of configurations drawn uniformly within the limits: for primitives, for meshes, and the first batch. If
the first batch shows few overlaps, the rest is skipped."""
_EXACT = 500
"""Largest number of configurations with overlapping spheres that exact geometry checks for a pair."""
_LOST, _LOST_OF_MESHES = 0.1, 0.003
"""Largest share of a pair's collision-free configurations that its spheres may report as touching without slack.

Robots of meshes have dozens of pairs whose spheres stick out everywhere. At 0.1, UR arms were reported free in 80 % of
their free configurations. A Fetch with 66 pairs was reported free in 95 % of them at 0.01, in 96 % at 0.003."""
_RESERVE = 0.0005
"""Margin above the largest clearance of spheres at which links touched [m]."""
_NEVER = 0.003
"""Margin below the deepest overlap of spheres if the links never touched [m]."""
_METHOD = 1, _SAMPLES, _SAMPLES_OF_MESHES, _FIRST, _EXACT, _LOST, _LOST_OF_MESHES, _RESERVE, _NEVER
"""Version of the algorithm, and its settings: stored results of others are ignored."""
_SLOW = 0.05
"""Robots whose slack took longer to compute are written to the folder [s]."""
_KEPT = 4096
"""Number of pairs whose slack is cached."""
_known: OrderedDict[bytes, float] = OrderedDict()
_lock = Lock()


def self_slack(
    scene: Scene,
    robot: RobotArrays,
    geoms: Sequence[Sequence[tuple[int, int]]],
    impact_tables: ImpactArrays,
) -> Float[Array, " pair"]:
    """Return the clearance of spheres at which the links of each pair touch [m], at most 0.

    Args:
        scene: The scene.
        robot: Tables with pairs of links.
        geoms: For each pair of links, the pairs of geoms that may touch.
        impact_tables: Tables of the scene.
    """
    apart = np.flatnonzero(robot.self_pair[:, 0] != robot.self_pair[:, 1])  # equal links: a base in contact, never free
    keys = [_key(robot, pair) for pair in robot.self_pair[apart]]
    began, name = time.perf_counter(), blake2b(repr(_METHOD).encode() + b"".join(keys), digest_size=32).hexdigest()
    with _lock:
        found = [_known.get(key) for key in keys]
    if None in found and (stored := _stored(name, len(keys))) is not None:
        found = stored
    values = [
        _slack(scene, robot, robot.self_pair[k], geoms[k], impact_tables) if known is None else known
        for k, known in zip(apart.tolist(), found, strict=True)
    ]
    if time.perf_counter() - began > _SLOW:
        disk_cache.write(name, np.array(values))
    with _lock:
        _known.update(zip(keys, values, strict=True))
        while len(_known) > _KEPT:
            _known.popitem(last=False)
    slack = np.zeros(len(robot.self_pair))
    slack[apart] = values
    return slack


def forget() -> None:
    """Drop the slack in memory; that in the folder stays."""
    with _lock:
        _known.clear()


def _stored(name: str, count: int) -> list[float] | None:
    """Return the slack of all pairs of a robot from the folder of covers, unless the file makes no sense."""
    found = disk_cache.read(name)
    if found is None or found.shape != (count,) or not (np.isfinite(found) & (found <= 0.0)).all():
        return None
    return found.tolist()


def _key(robot: RobotArrays, pair: Int[Array, " 2"]) -> bytes:
    """Return a hash of the data that the slack of a pair depends on: its spheres and the relative motion of its links.

    Joints that move both links are left out, since the limits of a base, for example, differ between scenes.
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
    """Return the frames that a link moves with, its own included."""
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
    impact_tables: ImpactArrays,
) -> float:
    kernels = Kernels(
        replace(robot, self_pair=pair[None], self_slack=np.zeros(1)), WorldArrays.nothing(), impact_tables
    )
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

"""Convex parts of a mesh: MuJoCo collides with convex hulls, and the hull of a bent link fills the bend.

References:
    X. Wei et al., "Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity and Tree Search",
    ACM Transactions on Graphics 41(4), 2022 (the library `coacd`).
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import time
from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from graceful_plan import disk_cache
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import UnsupportedError

_LOG = logging.getLogger(__name__)

_STICKS_OUT = 0.025
"""Distance of a hull from the mesh surface above which the mesh is divided [m]. Collision spheres also protrude by
1 cm. A UR5 has 3.8 cm at its long links, 0.7 to 1.8 at others. Volumes are no measure: many meshes are hollow."""
_PROTRUDES = 0.005
"""The same distance for links that the caller names, such as jaws [m]: hulls of an SO-101's jaws protrude by 2 cm."""
_CONCAVITY = 0.05
"""Largest concavity of a part relative to the mesh: the library's default."""
_MOST_PARTS = 16
_LARGE = 20_000
"""Number of triangles from which the faster settings are used: for a link of a Z1, 4 s instead of 13 s.
With them for all meshes, with more parts or a smaller threshold, fewer queries of UR3 and UR5 were solved."""
_SWIFT = MappingProxyType({"preprocess_mode": "on", "preprocess_resolution": 30, "mcts_iterations": 60})
_METHOD = 1
"""Version of the method; cached parts of other versions are not used."""
_SAMPLES = 20_000
"""Surface points that must be inside a part."""
_OUTSIDE = 1e-6
"""Largest distance of these points outside all parts [m]."""
_AT_A_TIME = 1_000_000
"""Number of point-to-face distances computed at a time; 8 MB."""
_THICKNESS = 1e-4
"""Thickness given to flat parts [m]."""
HINT = "pip install '.[urdf]'"


def convex_parts(
    triangles: Float[Array, "triangle 3 3"], name: str, *, needed: bool, closely: bool = False
) -> list[Float[Array, "_ 3"]]:
    """Divide a mesh into parts with tight hulls; return their vertices, or an empty list if its own hull is tight.

    Every sampled point of the surface is inside a hull: points outside of all hulls are added to the nearest part.

    Args:
        triangles: Triangles of the mesh [m].
        name: Name of the mesh, for messages.
        needed: Whether to raise, instead of logging a warning, if the library is missing.
        closely: Whether to divide a mesh whose hull protrudes by a few millimetres, too.

    Raises:
        UnsupportedError: If `needed` and the library is missing.
    """
    allowed = _PROTRUDES if closely else _STICKS_OUT
    method = repr((_METHOD, allowed, _CONCAVITY, _MOST_PARTS, _LARGE, sorted(_SWIFT.items())))
    digest = hashlib.sha256(method.encode() + triangles.tobytes()).hexdigest()
    found = disk_cache.read(digest)
    if found is not None and found.ndim == 2 and found.shape[1] == 4 and np.isfinite(found).all():
        return _unpacked(found)
    surface, hull = _surface(triangles), _hull(triangles.reshape(-1, 3))
    if hull is None:
        return []
    spatial = importlib.import_module("scipy.spatial")
    sticks_out = float(spatial.KDTree(surface).query(_surface(_facets(hull)))[0].max())
    if sticks_out < allowed:
        disk_cache.write(digest, np.zeros((0, 4)))
        return []
    try:
        coacd = importlib.import_module("coacd")
    except ImportError:
        told = f"the hull of {name} sticks out of it by {100.0 * sticks_out:.1f} cm; to divide it, {HINT}"
        if needed:
            raise UnsupportedError(told) from None
        _LOG.warning(told)
        return []
    started = time.perf_counter()
    _LOG.info("dividing %s into convex parts; the result will be cached", name)
    parts = _all_inside(_divided(coacd, triangles), surface)
    _LOG.info("%s has %d convex parts; found in %.1f s", name, len(parts), time.perf_counter() - started)
    disk_cache.write(
        digest, np.vstack([np.column_stack([np.full(len(part), k), part]) for k, part in enumerate(parts)])
    )
    return parts


def _divided(coacd: Any, triangles: Float[Array, "triangle 3 3"]) -> list[Float[Array, "_ 3"]]:
    corners, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    coacd.set_log_level("error")
    how = _SWIFT if len(triangles) > _LARGE else {}
    mesh = coacd.Mesh(corners, index.reshape(-1, 3).astype(np.int32))
    parts = coacd.run_coacd(mesh, threshold=_CONCAVITY, max_convex_hull=_MOST_PARTS, seed=0, **how)
    return [np.asarray(vertices) for vertices, _ in parts]


def _all_inside(parts: Sequence[Float[Array, "_ 3"]], points: Float[Array, "n 3"]) -> list[Float[Array, "_ 3"]]:
    """Add surface points outside of all parts to the nearest part; keep only the vertices of hulls."""
    outside = np.stack([_outside(part, points) for part in parts])
    nearest, left = outside.argmin(axis=0), outside.min(axis=0) > _OUTSIDE
    grown = [np.vstack([part, points[left & (nearest == k)]]) for k, part in enumerate(parts)]
    return [part[_hull(part).vertices] for part in map(_solid, grown)]


def _solid(part: Float[Array, "_ 3"]) -> Float[Array, "_ 3"]:
    """Return a part, thickened if it is so flat that it has no hull: MuJoCo rejects flat meshes."""
    thickness, grown = _THICKNESS, part
    while _hull(grown) is None:
        grown = np.vstack([part, *(part + thickness * axis for axis in np.eye(3))])
        thickness *= 2.0
    return grown


def part_triangles(part: Float[Array, "_ 3"]) -> Float[Array, "triangle 3 3"]:
    """Return the hull of a part, counter-clockwise from outside."""
    return _facets(_hull(part))


def _facets(hull: Any) -> Float[Array, "triangle 3 3"]:
    corners = hull.points[hull.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ti,ti->t", normal, hull.equations[:, :3]) < 0.0
    corners[inward] = corners[inward][:, [0, 2, 1]]
    return corners


def _surface(triangles: Float[Array, "triangle 3 3"]) -> Float[Array, "n 3"]:
    """Return the corners of a mesh, and points sampled uniformly on its surface."""
    rng = np.random.default_rng(0)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    corners = np.unique(triangles.reshape(-1, 3), axis=0)
    if area.sum() <= 0.0:
        return corners
    chosen = triangles[rng.choice(len(triangles), size=_SAMPLES, p=area / area.sum())]
    weights = rng.dirichlet(np.ones(3), size=_SAMPLES)
    return np.vstack([corners, np.einsum("nk,nki->ni", weights, chosen)])


def _outside(part: Float[Array, "_ 3"], points: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Return a lower bound of the distance of points from a hull [m]; at most 0 inside."""
    hull = _hull(part)
    if hull is None:
        return np.linalg.norm(points[:, None] - part, axis=-1).min(axis=1)
    normals, offsets = hull.equations[:, :3].T, hull.equations[:, 3]
    some = np.array_split(points, max(1, len(points) * len(offsets) // _AT_A_TIME))
    return np.concatenate([(part @ normals + offsets).max(axis=1) for part in some])


def _hull(points: Float[Array, "_ 3"]) -> Any:
    """Return the hull of points; None if they are coplanar."""
    spatial = importlib.import_module("scipy.spatial")
    try:
        return spatial.ConvexHull(points)
    except (spatial.QhullError, ValueError):
        return None


def _unpacked(rows: Float[Array, "row 4"]) -> list[Float[Array, "_ 3"]]:
    return [rows[rows[:, 0] == k, 1:] for k in np.unique(rows[:, 0])]

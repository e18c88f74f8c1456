"""Cover convex hulls and ellipsoids with spheres: samples of the body, then balls around the samples that cover most.

See `sphere_cover` for shapes whose covers have a closed form, and for the bound of the protrusion.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core import _native
from graceful_plan.core.sphere_cover import MAX_PROTRUSION, Cover

CANDIDATES = 40
"""Number of balls compared at each step of the greedy cover of a hull."""
_BETWEEN_FACES = 2e-4
"""Farthest that a corner of a simplified body may lie outside a face of its hull [m]."""
_FEW_FACES = 100
"""Number of faces up to which hulls are not simplified."""
_SHELL = 2.0
"""Depth of the surface layer, which is covered first [pitches]."""
_ON_SURFACE = 1e-3
"""Tolerance of the box test for points that were projected onto a hull [m]."""
_ROUNDING = 1e-12
"""Margin for rounding of squared distances [m^2]."""
_FINEST, _FINE, _COARSE = 0.0032, 0.0038, 0.0057
"""Edges of lattice cells in small bodies, links, and large bodies [m]. A ball is trusted to cover its radius less the
gap between points, so finer lattices need fewer balls: links of an arm 20 % fewer at 3.8 mm than at 5.7 mm."""
_STEPS = 60
"""Largest number of steps of Newton's method; about twelve suffice."""
_GAP = np.sqrt(5.0) / 4.0
"""Largest distance of any point to a body-centred cubic lattice [cell edges]. With as many points, that of a simple
cubic lattice is about a quarter larger."""
_POINTS = (12_000, 300_000)
"""Numbers of lattice cells: with fewer, a body gets a finer lattice; with more, a coarser one."""


def greedy_cover(points: Float[Array, "n 3"], depth: Float[Array, " n"], protrusion: float, pitch: float) -> Cover:
    """Cover a body by balls around some of its points.

    Args:
        points: Samples of the body; every point of the body is within `pitch` of one.
        depth: Lower bound of the depth of each point inside the body [m].
        protrusion: Largest protrusion of the balls [m].
        pitch: Density of `points` [m].
    """
    radii = np.maximum(depth, 0.0) + protrusion
    # A ball surely covers its radius less the gap between samples.
    within = np.maximum(radii - pitch, 0.0) ** 2 - _ROUNDING
    order = np.argsort(depth, kind="stable")  # the surface first, and on it the corners
    near = int(np.searchsorted(depth[order], _SHELL * pitch))  # few deep points remain once the surface is covered
    needed = _native.ball_cover(
        points=points,
        reach=within,
        depth=depth,
        order=order.astype(np.int32),
        first=near,
        candidates=CANDIDATES,
    )
    return points[needed], radii[needed]


def _lattice(lower: Float[Array, " 3"], upper: Float[Array, " 3"], pitch: float) -> Float[Array, "n 3"]:
    """Return the points of a body-centred cubic lattice in and just around a box."""
    axes = [np.arange(a - pitch, b + pitch, pitch) for a, b in zip(lower, upper, strict=True)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.concatenate([corners, corners + 0.5 * pitch])


def samples_of_convex(
    vertices: Float[Array, "n 3"], planes: Float[Array, "face 4"], pitch: float
) -> tuple[Float[Array, "m 3"], Float[Array, " m"]]:
    """Sample a convex body: lattice points inside, projections of those just outside; return points and heights."""
    grid = _lattice(vertices.min(axis=0), vertices.max(axis=0), pitch)
    height, _ = heights(grid, planes)
    near = np.concatenate([grid[height <= _GAP * pitch], vertices])
    height = np.append(height[height <= _GAP * pitch], np.full(len(vertices), np.inf))
    projected = np.flatnonzero(height > 0.0)
    outside = projected[: len(projected) - len(vertices)]
    for _ in range(30):  # alternate projections onto the violated half-spaces
        excess, worst = heights(near[outside], planes)
        near[outside] -= np.maximum(excess, 0.0)[:, None] * planes[worst, :3]
        outside = outside[excess > 1e-6]
        if len(outside) == 0:
            break
    height[projected] = heights(near[projected], planes)[0]
    return near, height


def heights(points: Float[Array, "n 3"], planes: Float[Array, "face 4"]) -> tuple[Float[Array, " n"], Int[Array, " n"]]:
    """Return the largest height of each point over a face [m], negative inside the body, and the index of that face."""
    return _native.heights(points=points, planes=planes)


Hull = tuple[Float[Array, "_ 3"], Float[Array, "_ 4"]]
"""Vertices, and the planes of the faces: outward normals n and offsets d, n . x <= d inside."""


def hull_cover(hulls: Sequence[Hull], protrusion: float = MAX_PROTRUSION) -> Cover:
    """Cover convex hulls by balls that stick out of their union; where hulls overlap, one ball may serve several."""
    bounded = [(vertices, fewer_planes(vertices, planes)) for vertices, planes in hulls]
    pitch = max(_pitch(np.ptp(vertices, axis=0), protrusion) for vertices, _ in bounded)
    samples, depths = [], []
    for k, (vertices, planes) in enumerate(bounded):
        points, height = samples_of_convex(vertices, planes, pitch)
        # Points deep inside an earlier hull are dropped; the samples of that hull cover them.
        before = _depth(points, bounded[:k])
        own = before < _GAP * pitch
        after = _depth(points[own], bounded[k + 1 :])
        samples.append(points[own])
        depths.append(np.maximum.reduce([before[own], -height[own], after]))
    return greedy_cover(np.concatenate(samples), np.concatenate(depths), protrusion, _GAP * pitch)


def _depth(points: Float[Array, "n 3"], hulls: Sequence[Hull]) -> Float[Array, " n"]:
    """Return the depth of each point in the hull it is deepest in [m]; minus infinity outside all boxes."""
    depth = np.full(len(points), -np.inf)
    for vertices, planes in hulls:
        lower, upper = vertices.min(axis=0) - _ON_SURFACE, vertices.max(axis=0) + _ON_SURFACE
        near = np.flatnonzero(((points >= lower) & (points <= upper)).all(axis=1))
        depth[near] = np.maximum(depth[near], -heights(points[near], planes)[0])
    return depth


def fewer_planes(
    vertices: Float[Array, "n 3"], planes: Float[Array, "face 4"], away: float = _BETWEEN_FACES
) -> Float[Array, "some 4"]:
    """Return fewer planes that bound nearly the same body: it contains the hull, and its corners are near the faces.

    Scanned links have thousands of faces, and the time of a cover is proportional to their number. The algorithm begins
    with a box and adds the faces that corners are farthest outside of.

    Args:
        vertices: Vertices of the hull.
        planes: Planes of all its faces.
        away: Farthest that a corner may lie outside any face [m].
    """
    if len(planes) <= _FEW_FACES:
        return planes
    from scipy.spatial import HalfspaceIntersection, QhullError  # importing the library must not import scipy

    middle, upright = vertices.mean(axis=0), np.vstack([np.eye(3), -np.eye(3)])
    box = np.column_stack([upright, (vertices @ upright.T).max(axis=0)])
    chosen = np.zeros(len(planes), dtype=bool)
    while not chosen.all():
        some = np.vstack([box, planes[chosen]])
        try:
            corners = HalfspaceIntersection(np.column_stack([some[:, :3], -some[:, 3]]), middle).intersections
        except QhullError:  # a sheet has no inside
            return planes
        outside, face = heights(corners[np.isfinite(corners).all(axis=1)], planes)
        beyond = np.unique(face[outside > away])
        if len(beyond) == 0 or chosen[beyond].all():
            break
        chosen[beyond] = True
    return np.vstack([box, planes[chosen]])


def _pitch(extent: Float[Array, " 3"], protrusion: float) -> float:
    """Return the lattice constant [m]: fine enough that its gaps cost few spheres, without too many points."""
    few, many = (float(np.prod(extent) / count) ** (1.0 / 3.0) for count in _POINTS)
    coarsest = min(max(_FINE, many), _COARSE) * max(1.0, protrusion / MAX_PROTRUSION)
    return min(max(_FINEST, few), coarsest)


@lru_cache(maxsize=64)
def ellipsoid_cover(semi_axes: tuple[float, float, float], protrusion: float = MAX_PROTRUSION) -> Cover:
    """Cover an ellipsoid."""
    axes = np.asarray(semi_axes)
    pitch = _pitch(2.0 * axes, protrusion)
    grid = _lattice(-axes, axes, pitch)
    n = int(4.0 * np.pi * np.sort(axes)[1:].prod() / (0.5 * pitch) ** 2) + 100
    k = np.arange(n) + 0.5  # a Fibonacci lattice on the unit sphere, stretched
    polar, azimuth = np.arccos(1 - 2 * k / n), np.pi * (1 + 5**0.5) * k
    unit = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    level = np.linalg.norm(grid / axes, axis=1)
    points = np.concatenate([grid[level < 1.0], unit * axes])
    return greedy_cover(points, _ellipsoid_depth(points, axes), protrusion, _GAP * pitch)


def _ellipsoid_depth(points: Float[Array, "n 3"], axes: Float[Array, " 3"]) -> Float[Array, " n"]:
    """Return the distance of points inside an ellipsoid to its surface, by the secular equation (Eberly 2013).

    Newton's method is applied to 1 / |p| - 1, which is nearly linear, and approaches the root from the left (More and
    Sorensen 1983).
    """
    y = np.abs(points) + 1e-9  # off the symmetry planes, where the nearest point is not unique
    shortest = int(np.argmin(axes))
    t = axes[shortest] * y[:, shortest] - axes[shortest] ** 2
    for _ in range(_STEPS):
        away = 1.0 / (t[:, None] + axes**2)
        squares = np.square(axes * y * away)
        size = np.sqrt(squares.sum(axis=1))
        step = (size - 1.0) * size / (squares * away).sum(axis=1)
        t += np.maximum(step, 0.0)
        if (step <= 1e-13 * axes.max() ** 2).all():
            break
    nearest = axes**2 * y / (np.minimum(t, 0.0)[:, None] + axes**2)
    return np.linalg.norm(nearest - y, axis=1)

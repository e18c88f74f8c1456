"""Cover a geom with spheres that stick out of it by less than a given amount.

All covers are computed in the geom's own frame: centres [m] and radii [m]. A ball of radius R around a point at depth
d inside a convex body sticks out by at most R - d; this bounds the protrusion of every sphere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from graceful_plan.array_types import Float, Int

Array = np.ndarray

MAX_PROTRUSION = 0.0095
"""Largest protrusion of a cover from its geom [m]; the rest of the promised 1 cm is for float32 and samples."""

METHOD = 5
"""Version of the algorithm; increase it when covers change, so that old ones in the folder are ignored."""
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
_CHUNK = 65_536
"""Number of heights of points over faces that are computed at a time; 0.5 MB stays in the cache, 16 MB take 4 times as
long."""
MANY = 1500
"""Number of spheres of one geom above which larger ones are used, which stick out farther."""
_PER_AREA = 0.15
"""Spheres per surface area of the bounding box, times protrusion squared; measured on cubes, plates and rods."""
_THIN = 1.4
"""Factor on the protrusion for bodies much thinner than it, where balls cover less to the sides."""
_LAYERS = (1, 2, 3, 4, 5, 6, 8, 11, 15, 21, 30, 42)
"""Numbers of layers tried for the cover of a cylinder."""

Cover = tuple[Float[Array, "sphere 3"], Float[Array, " sphere"]]


def roomy(half: tuple[float, float, float], protrusion: float = MAX_PROTRUSION) -> float:
    """Return the protrusion at which about `MANY` spheres cover a geom in a box of these half sizes [m].

    It is `protrusion` unless the geom is large: a cube of more than 0.4 m.
    """
    enough = float(np.sqrt(_PER_AREA * _surface(half) / MANY))
    if enough > max(3.0 * min(half), protrusion):
        enough *= _THIN
    return max(protrusion, enough, 1.5 * max(half) / MANY)  # the last term is for thin rods


def likely_count(half: tuple[float, float, float], protrusion: float) -> float:
    """Estimate the number of spheres that cover a body that fills a box of these half sizes."""
    return _PER_AREA * _surface(half) / protrusion**2


def _surface(half: tuple[float, float, float]) -> float:
    a, b, c = half
    return 8.0 * (a * b + b * c + c * a)


def sphere_cover(radius: float) -> Cover:
    """Cover a sphere by itself."""
    return np.zeros((1, 3)), np.array([radius])


def capsule_cover(radius: float, half_length: float, protrusion: float = MAX_PROTRUSION) -> Cover:
    """Cover a capsule along z by spheres on its axis."""
    R = radius + protrusion
    reach = half_length - protrusion  # a ball this far out contains the whole end cap
    if reach <= 0.0:
        return np.zeros((1, 3)), np.array([radius + half_length])
    return _axis(reach, np.sqrt(R**2 - radius**2)), np.full(_axis_count(reach, np.sqrt(R**2 - radius**2)), R)


def _axis_count(reach: float, half_gap: float) -> int:
    return max(2, int(np.ceil(reach / half_gap)) + 1)


def _axis(reach: float, half_gap: float) -> Float[Array, "sphere 3"]:
    z = np.linspace(-reach, reach, _axis_count(reach, half_gap))
    return np.stack([0 * z, 0 * z, z], axis=1)


def box_cover(half: tuple[float, float, float], protrusion: float = MAX_PROTRUSION) -> Cover:
    """Cover a box by a lattice of spheres, one around each cell, and its core by fewer, larger spheres."""
    half_sizes = np.asarray(half, dtype=float)
    counts = _box_lattice(half_sizes, protrusion)
    cell = half_sizes / counts
    index = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    outer = np.any((index == 0) | (index == counts - 1), axis=1)
    centres = (2 * index[outer] + 1) * cell - half_sizes
    radii = np.full(len(centres), np.linalg.norm(cell))
    if np.all(counts > 2):  # the core may bulge into the outer layer
        core, core_radii = box_cover(tuple(half_sizes - 2 * cell), protrusion + 2 * cell.min())
        return np.concatenate([centres, core]), np.concatenate([radii, core_radii])
    return centres, radii


def _box_lattice(half: Float[Array, " 3"], protrusion: float) -> Array:
    """Return the fewest cells per axis such that the ball around a cell sticks out of it by at most `protrusion`."""
    best = None
    for layers in range(1, 200):  # along the thinnest axis
        pitch = half.min() / layers
        width = np.sqrt(((pitch + protrusion) ** 2 - pitch**2) / 2.0)  # along the other axes, covered by the ball
        counts = np.maximum(np.ceil(half / width), 1).astype(int)
        counts[np.argmin(half)] = layers
        while np.linalg.norm(half / counts) - (half / counts).min() > protrusion:
            counts[np.argmax(half / counts)] += 1
        if best is None or counts.prod() < best.prod():
            best = counts
        elif counts.prod() > 4 * best.prod():
            break
    assert best is not None  # one layer always fits
    return best


def cylinder_cover(radius: float, half_length: float, protrusion: float = MAX_PROTRUSION) -> Cover:
    """Cover a cylinder along z by the smallest of several covers; thin ones use spheres on the axis, plates rings."""
    options = [_cylinder_on_axis(radius, half_length, n, protrusion) for n in _LAYERS[:8]]
    options += [_cylinder_with_core(radius, half_length, n, protrusion) for n in _LAYERS]
    return min((cover for cover in options if cover is not None), key=lambda cover: len(cover[1]))


def _cylinder_on_axis(radius: float, half_length: float, n: int, protrusion: float) -> Cover | None:
    """Cover a cylinder by rings at both ends, in layers of half height `half_length / n`, and spheres on the axis."""
    c = half_length / n
    rings = _rings(radius, c, protrusion)
    if rings is None or n == 1:
        return None
    gap, R = half_length - 2.0 * c, radius + protrusion
    count = max(1, int(np.ceil(gap / np.sqrt(R**2 - radius**2)))) if gap > 0.0 else 0
    z = (np.arange(count) + 0.5) * 2.0 * gap / max(count, 1) - gap
    if count and R > half_length - np.abs(z).max() + protrusion:  # spheres would bulge out of the ends
        return None
    ends = [_at_height(rings, z_end) for z_end in (half_length - c, c - half_length)]
    return _joined([*ends, (np.stack([0 * z, 0 * z, z], axis=1), np.full(count, R))])


def _cylinder_with_core(radius: float, half_length: float, n: int, protrusion: float) -> Cover | None:
    """Cover a cylinder by rings in `n` layers, only the outermost between the ends, and its core by larger spheres."""
    c = half_length / n
    rings = _rings(radius, c, protrusion)
    if rings is None:
        return None
    heights = (2.0 * np.arange(n) + 1.0) * c - half_length
    if n < 3 or len(rings) == 1:
        return _joined([_at_height(rings, z) for z in heights])
    inner, height = rings[0].inner, half_length - 2.0 * c
    behind = protrusion + min(radius - inner, 2.0 * c)  # the core may bulge into the layers around it
    core = next(cover for m in range(1, 1000) if (cover := _in_layers(inner, height, m, behind)) is not None)
    ends = [_at_height(rings, z) for z in (heights[0], heights[-1])]
    return _joined([*ends, *(_at_height(rings[:1], z) for z in heights[1:-1]), core])


def _in_layers(radius: float, half_length: float, n: int, protrusion: float) -> Cover | None:
    c = half_length / n
    rings = _rings(radius, c, protrusion)
    return None if rings is None else _joined([_at_height(rings, (2 * k + 1) * c - half_length) for k in range(n)])


@dataclass(frozen=True)
class _Ring:
    """Equal balls around the axis that cover a slab of a disc from its rim to the radius `inner`."""

    xy: Float[Array, "ball 2"]
    radius: float
    inner: float


def _rings(radius: float, c: float, protrusion: float) -> list[_Ring] | None:
    """Cover the slab |z| <= c of a cylinder by rings of balls that stick out of it by at most `protrusion`."""
    if np.hypot(radius, c) - min(radius, c) <= protrusion:
        return [_Ring(np.zeros((1, 2)), float(np.hypot(radius, c)), 0.0)]
    if c > radius:  # balls that reach both faces would bulge out of the side
        return None
    R = c + protrusion
    rho = np.sqrt(R**2 - c**2)  # radius that a ball covers on both faces of the slab
    rings: list[_Ring] = []
    outer, d = radius, radius - c
    while outer > rho:
        cosine = (outer**2 + d**2 - rho**2) / (2.0 * outer * d) if d > 0.0 else 1.0
        if cosine > 0.999:  # the ring hardly covers anything near `outer`
            return None
        m = max(3, int(np.ceil(np.pi / np.arccos(cosine))))
        angle = 2.0 * np.pi * (np.arange(m) + 0.5 * (len(rings) % 2)) / m
        inner = d * np.cos(np.pi / m) - np.sqrt(max(0.0, rho**2 - (d * np.sin(np.pi / m)) ** 2))
        rings.append(_Ring(d * np.stack([np.cos(angle), np.sin(angle)], axis=1), float(R), max(0.0, float(inner))))
        if inner <= 0.0:
            return rings
        outer, d = inner, inner - 0.35 * rho  # the next ring overlaps with this one
    return [*rings, _Ring(np.zeros((1, 2)), float(R), 0.0)]


def _at_height(rings: list[_Ring], z: float) -> Cover:
    xy = np.concatenate([ring.xy for ring in rings])
    radii = np.concatenate([np.full(len(ring.xy), ring.radius) for ring in rings])
    return np.column_stack([xy, np.full(len(xy), z)]), radii


def _joined(covers: list[tuple[Array, Array]]) -> Cover:
    return np.concatenate([c for c, _ in covers]), np.concatenate([r for _, r in covers])


def greedy_cover(points: Float[Array, "n 3"], depth: Float[Array, " n"], protrusion: float, pitch: float) -> Cover:
    """Cover a body by balls around some of its points.

    Args:
        points: Samples of the body; every point of the body is within `pitch` of one.
        depth: Lower bound of the depth of each point inside the body [m].
        protrusion: Largest protrusion of the balls [m].
        pitch: Density of `points` [m].
    """
    radii = np.maximum(depth, 0.0) + protrusion
    # A ball surely covers its radius less the gap between samples. |a - b|^2 = a.a + b.b - 2 a.b.
    within = np.maximum(radii - pitch, 0.0) ** 2 - _ROUNDING
    square = np.einsum("ni,ni->n", points, points)
    order = np.argsort(depth, kind="stable")  # the surface first, and on it the corners
    near = int(np.searchsorted(depth[order], _SHELL * pitch))
    picked: list[int] = []
    for left in (order[:near], order[near:]):  # few deep points remain once the surface is covered
        for k in picked:
            left = left[square[left] + square[k] - 2.0 * (points[left] @ points[k]) > within[k]]
        while len(left):
            first = left[0]
            able = np.flatnonzero(square + square[first] - 2.0 * (points @ points[first]) <= within)
            deepest = able[np.argsort(-depth[able], kind="stable")[:CANDIDATES]]
            spread = able[np.linspace(0, len(able) - 1, min(len(able), CANDIDATES)).astype(int)]
            able = np.union1d(deepest, spread)
            # The candidates contain the first point, so they cover nothing farther from it than a diameter.
            from_first = square[left] + square[first] - 2.0 * (points[left] @ points[first])
            around = np.flatnonzero(from_first <= 4.0 * within[able].max() + _ROUNDING)
            some = left[around]
            apart = square[some] + square[able][:, None] - 2.0 * (points[able] @ points[some].T)
            covered = apart <= within[able][:, None]
            covered[:, 0] = True
            best = int(np.argmax(covered.sum(axis=1)))
            picked.append(int(able[best]))
            left = np.delete(left, around[covered[best]])
    needed = _needed(points, within, picked)
    return points[needed], radii[needed]


def _needed(points: Float[Array, "n 3"], within: Float[Array, " n"], picked: list[int]) -> list[int]:
    """Drop redundant balls, smallest coverage first; `within` are squared radii [m^2]."""
    square = np.einsum("ni,ni->n", points, points)
    covered = [np.flatnonzero(square + square[k] - 2.0 * (points @ points[k]) <= within[k]) for k in picked]
    times = np.zeros(len(points), dtype=int)
    for some in covered:
        times[some] += 1
    needed = np.ones(len(picked), dtype=bool)
    for k in np.argsort([len(some) for some in covered], kind="stable"):
        if times[covered[k]].min() > 1:
            needed[k] = False
            times[covered[k]] -= 1
    return [k for k, stays in zip(picked, needed, strict=True) if stays]


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
    height, face = np.empty(len(points)), np.empty(len(points), dtype=int)
    rows = max(1, _CHUNK // len(planes))
    for k in range(0, len(points), rows):
        over = points[k : k + rows] @ planes[:, :3].T - planes[:, 3]
        face[k : k + rows] = highest = np.argmax(over, axis=1)
        height[k : k + rows] = over[np.arange(len(over)), highest]
    return height, face


Hull = tuple[Float[Array, "_ 3"], Float[Array, "_ 4"]]
"""Vertices, and the planes of the faces: outward normals n and offsets d, n . x <= d inside."""


def hull_cover(hulls: Sequence[Hull], protrusion: float = MAX_PROTRUSION) -> Cover:
    """Cover convex hulls by balls that stick out of their union; where hulls overlap, one ball may serve several."""
    bounded = [(vertices, fewer_planes(vertices, planes)) for vertices, planes in hulls]
    pitch = max(_pitch(np.ptp(vertices, axis=0), protrusion) for vertices, _ in bounded)
    samples = []
    for k, (vertices, planes) in enumerate(bounded):
        points, _ = samples_of_convex(vertices, planes, pitch)
        # Points deep inside an earlier hull are dropped; the samples of that hull cover them.
        own = _depth(points, bounded[:k]) < _GAP * pitch
        samples.append(points[own])
    points = np.concatenate(samples)
    return greedy_cover(points, _depth(points, bounded), protrusion, _GAP * pitch)


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


def enclosing_sphere(centres: Float[Array, "sphere 3"], radii: Float[Array, " sphere"]) -> Float[Array, " 4"]:
    """Return a small sphere around spheres, by steps towards the furthest one (Badoiu and Clarkson 2003)."""
    centre = (centres.min(axis=0) + centres.max(axis=0)) / 2.0
    for k in range(1, 80):
        reach = np.linalg.norm(centres - centre, axis=1) + radii
        far = int(np.argmax(reach))
        centre = centre + (centres[far] - centre) * (1.0 - radii[far] / max(reach[far], 1e-12)) / (k + 1)
    return np.append(centre, np.max(np.linalg.norm(centres - centre, axis=1) + radii))

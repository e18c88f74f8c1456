"""Cover spheres, capsules, boxes and cylinders with spheres that stick out by less than a given amount.

All covers are computed in the geom's own frame: centres [m] and radii [m]. A ball of radius R around a point at depth
d inside a convex body sticks out by at most R - d; this bounds the protrusion of every sphere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Float

MAX_PROTRUSION = 0.0095
"""Largest protrusion of a cover from its geom [m]; the rest of the promised 1 cm is for float32 and samples."""

METHOD = 6
"""Version of the algorithm; increase it when covers change, so that old ones in the folder are ignored."""
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


def enclosing_sphere(centres: Float[Array, "sphere 3"], radii: Float[Array, " sphere"]) -> Float[Array, " 4"]:
    """Return a small sphere around spheres, by steps towards the furthest one (Badoiu and Clarkson 2003)."""
    centre = (centres.min(axis=0) + centres.max(axis=0)) / 2.0
    for k in range(1, 80):
        reach = np.linalg.norm(centres - centre, axis=1) + radii
        far = int(np.argmax(reach))
        centre = centre + (centres[far] - centre) * (1.0 - radii[far] / max(reach[far], 1e-12)) / (k + 1)
    return np.append(centre, np.max(np.linalg.norm(centres - centre, axis=1) + radii))

"""Random things of a few simple parts, standing on z = 0, and free places for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from graceful_plan.array_types import Array, Float

_GAP = 0.006
"""Least distance between things [m]."""
_TRIES = 40


@dataclass(frozen=True)
class MassPart:
    """A geom of a thing: kind and sizes as in MJCF, and its place in the thing's frame [m]."""

    kind: str
    size: tuple[float, ...]
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    @property
    def half(self) -> Float[Array, " 3"]:
        """Half sizes of the bounding box [m]."""
        if self.kind == "box":
            return np.array(self.size)
        if self.kind == "sphere":
            return np.full(3, self.size[0])
        return np.array([self.size[0], self.size[0], self.size[1] + (self.size[0] if self.kind == "capsule" else 0.0)])


class Taken(NamedTuple):
    """An occupied disc around a thing, seen from above [m]."""

    x: float
    y: float
    radius: float


def thing(rng: np.random.Generator, *, carried: bool = False) -> list[MassPart]:
    """Return a random thing that stands: a box, can, ball, slab, dish, tower, bottle, screen or hump."""
    makers = _CARRIED if carried else _MAKERS
    return makers[int(rng.integers(len(makers)))](rng, 0.6 if carried else 1.0)


def with_asymmetry(parts: list[MassPart], rng: np.random.Generator) -> list[MassPart]:
    """Return a thing that in 3 of 10 cases gets an asymmetric part, like the handle of a cup."""
    if rng.random() < 0.7:
        return parts
    low, high = extent(parts)
    size = rng.uniform(0.005, 0.015), 0.006, 0.3 * float(high[2] - low[2])
    return [*parts, MassPart("box", size, x=float(high[0]) + size[0], z=0.5 * float(low[2] + high[2]))]


def extent(parts: list[MassPart], turn: Float[Array, "3 3"] | None = None) -> tuple[Array, Array]:
    """Return the lowest and highest corner of a thing's bounding box, after an optional rotation [m]."""
    R = np.eye(3) if turn is None else turn
    centre = np.array([[part.x, part.y, part.z] for part in parts]) @ R.T
    half = np.array([part.half for part in parts]) @ np.abs(R).T
    return (centre - half).min(axis=0), (centre + half).max(axis=0)


def free_spot(
    parts: list[MassPart], a: float, b: float, taken: list[Taken], rng: np.random.Generator
) -> tuple[float, float, float] | None:
    """Find and occupy a free place on a board with half sizes a and b; return x, y and yaw, or None."""
    low, high = extent(parts)
    radius = float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))[:2]))
    if radius >= min(a, b):
        return None
    for _ in range(_TRIES):
        x, y = rng.uniform(-1.0, 1.0, size=2) * (np.array([a, b]) - radius)
        if all(np.hypot(x - other.x, y - other.y) > radius + other.radius + _GAP for other in taken):
            taken.append(Taken(float(x), float(y), radius))
            return float(x), float(y), float(rng.uniform(-np.pi, np.pi))
    return None


# --- kinds ------------------------------------------------------------------------------------------------------------


def _raised(kind: str, size: tuple[float, ...], z: float = 0.0) -> MassPart:
    part = MassPart(kind, size)
    return replace(part, z=z + float(part.half[2]))


def _box(rng: np.random.Generator, scale: float) -> list[MassPart]:
    return [_raised("box", tuple((scale * rng.uniform(0.02, 0.07, size=3)).tolist()))]


def _can(rng: np.random.Generator, scale: float) -> list[MassPart]:
    return [_raised("cylinder", (scale * rng.uniform(0.02, 0.06), scale * rng.uniform(0.03, 0.1)))]


def _ball(rng: np.random.Generator, scale: float) -> list[MassPart]:
    return [_raised("sphere", (scale * rng.uniform(0.025, 0.07),))]


def _slab(rng: np.random.Generator, scale: float) -> list[MassPart]:
    return [_raised("box", (*(scale * rng.uniform(0.05, 0.16, size=2)).tolist(), rng.uniform(0.004, 0.02)))]


def _dish(rng: np.random.Generator, scale: float) -> list[MassPart]:
    return [_raised("cylinder", (scale * rng.uniform(0.06, 0.13), rng.uniform(0.005, 0.02)))]


def _tower(rng: np.random.Generator, scale: float) -> list[MassPart]:
    return [_raised("box", (*(scale * rng.uniform(0.02, 0.05, size=2)).tolist(), scale * rng.uniform(0.08, 0.17)))]


def _bottle(rng: np.random.Generator, scale: float) -> list[MassPart]:
    body = _raised("cylinder", (scale * rng.uniform(0.025, 0.05), scale * rng.uniform(0.05, 0.1)))
    top = 2.0 * float(body.half[2])
    return [body, _raised("cylinder", (0.4 * body.size[0], scale * rng.uniform(0.02, 0.05)), top)]


def _screen(rng: np.random.Generator, scale: float) -> list[MassPart]:
    """Return a foot with an upright back, like a laptop."""
    foot = _raised("box", (scale * rng.uniform(0.06, 0.12), scale * rng.uniform(0.08, 0.18), 0.01))
    back = _raised("box", (0.008, foot.size[1], scale * rng.uniform(0.06, 0.14)), 0.02)
    return [foot, replace(back, x=float(foot.size[0]) - 0.01)]


def _hump(rng: np.random.Generator, scale: float) -> list[MassPart]:
    """Return a low rounded thing, like a sitting animal."""
    return [_raised("capsule", (scale * rng.uniform(0.03, 0.07), scale * rng.uniform(0.02, 0.06)))]


_MAKERS = (_box, _can, _ball, _slab, _dish, _tower, _bottle, _screen, _hump)
_CARRIED = (_box, _box, _can, _can, _slab, _dish, _tower, _tower, _bottle, _bottle, _ball)

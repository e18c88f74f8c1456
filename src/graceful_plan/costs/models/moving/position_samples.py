"""Sample positions of equal weight around the predicted position of a moving entity, and sample times of its path.

The deviation of an entity from its prediction at the release persists while the object falls, and grows with the
standard deviation; each sample position is followed separately.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_whole
from graceful_plan.scene.moving import MovingEntity

PLACES = 24
"""Default and largest number of sample positions of a normal distribution; even, and no multiple of `_STRIDE`."""
MOST_SAMPLES = 64
"""Largest number of sample times of a predicted path; the capacity of the core."""
_SAMPLE_STEP = 0.025, 0.1  # least and greatest distance between positions at these times [m]
_GOLDEN, _STRIDE = np.pi * (3.0 - np.sqrt(5.0)), 7


def check_places(places: int) -> None:
    """Raise SettingError unless `places` is a supported number of sample positions."""
    if not (is_whole(places) and 4 <= places <= PLACES and places % 2 == 0 and places % _STRIDE):
        raise SettingError("places", places, f"an even number from 4 to {PLACES}, and no multiple of {_STRIDE}")


def normal_places(count: int = PLACES) -> Float[Array, "place 2"]:
    """Return sample positions of equal weight for a normal distribution with standard deviation 1.

    They are the points of a sunflower spiral and their mirror images, scaled so that their variance plus that within
    their cells is 1. Neighbours in the list are far apart.
    """
    k = np.arange(count // 2)
    radius, angle = np.sqrt(-2.0 * np.log(1.0 - (k + 0.5) / len(k))), k * _GOLDEN
    half = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    half = half @ np.linalg.inv(np.linalg.cholesky(half.T @ half / len(k))).T * np.sqrt(1.0 - cell_of(count) ** 2)
    return np.concatenate([half, -half])[_STRIDE * np.arange(count) % count]


def cell_of(count: int) -> float:
    """Return the standard deviation within the cell of each of `count` sample positions, relative to that of all."""
    return float(np.sqrt(2.0 * np.pi / 12.0 / count))


def path_times(entity: MovingEntity) -> Float[Array, " k"]:
    """Return the midpoints of equal time intervals of the predicted path [s]."""
    duration = entity.t[-1] - entity.t[0]
    length = np.linalg.norm(np.diff(entity.position, axis=0), axis=1).sum() + entity.growth * duration
    length += np.abs(np.diff(entity.yaw)).sum() * np.linalg.norm(entity.half_size[:2])
    step = np.clip(0.5 * entity.half_size[:2].min(), *_SAMPLE_STEP)
    count = int(np.clip(np.ceil(length / step), 1, MOST_SAMPLES))
    return entity.t[0] + duration * (np.arange(count) + 0.5) / count

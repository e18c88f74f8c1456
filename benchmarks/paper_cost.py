"""The paper's safety cost as its code computes it, which differs from its text; for `paper_table` only.

The robot is the hand and two fingers, each judged separately; the carried object is left out, and the table counts. The
bounding boxes are softened to have gradients: maxima become log-sum-exp. The test of heights of Algorithm 1 is off, and
the sum over sampled configurations is scaled by 0.01.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from graceful_plan import Scene

Array = np.ndarray

SCALE = 0.01
SHARPNESS = 100.0
"""Sharpness of the log-sum-exp [1/m]; boxes become about 1.4 cm larger on each side."""

_FINGER = ((-0.0105, 0.0, 0.0), (0.0105, 0.0264, 0.0538))
BOXES = {
    "panda/hand": ((-0.0316, -0.1024, -0.0258), (0.0316, 0.1024, 0.0659)),
    "panda/left_finger": _FINGER,
    "panda/right_finger": _FINGER,
}
"""Boxes around the hand and the fingers, lower and upper corner in the frame of the body [m]."""


def as_coded(scene: Scene, samples: Sequence[Array], *, soft: bool = True) -> float:
    """Return the paper's safety cost of some configurations.

    Args:
        scene: Scene with a Panda.
        samples: Configurations of the sum.
        soft: False for the exact boxes, to compare.
    """
    return SCALE * sum(_expected_severity(scene, q, soft) for q in samples)


def _expected_severity(scene: Scene, q: Array, soft: bool) -> float:
    data, model = scene.data_at(q), scene.model
    ends = {False: (np.min, np.max), True: (_soft_min, _soft_max)}[soft]
    total = 0.0
    for name, box in BOXES.items():
        body = data.body(name)
        corners = (body.xpos + _corners(*box) @ body.xmat.reshape(3, 3).T)[:, :2]
        part = [end(corners, axis=0) for end in ends]
        for entity in scene.entities.values():
            boxes = [_footprint(model.geom_aabb[g], data.geom_xpos[g], data.geom_xmat[g]) for g in entity.geoms]
            total += entity.severity["body"] * _probability(part, boxes, ends)
    return total


def _probability(part: Sequence[Array], boxes: Sequence[tuple[Array, Array]], ends: tuple) -> float:
    """Return the greater of the shares of the overlap in the areas of both, over the pairs that overlap."""
    least, greatest = ends
    overlap = of_part = of_entity = 0.0
    for lower, upper in boxes:
        size = least([part[1], upper], axis=0) - greatest([part[0], lower], axis=0)
        if (size > 0.0).all():
            overlap += float(np.prod(size))
            of_part += float(np.prod(part[1] - part[0]))
            of_entity += float(np.prod(upper - lower))
    return max(overlap / of_part, overlap / of_entity) if overlap else 0.0


def _footprint(aabb: Array, position: Array, rotation: Array) -> tuple[Array, Array]:
    """Return the lower and upper corner, seen from above, of a geom's box in W."""
    corners = position + _corners(aabb[:3] - aabb[3:], aabb[:3] + aabb[3:]) @ rotation.reshape(3, 3).T
    return corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)


def _corners(lower: Sequence[float] | Array, upper: Sequence[float] | Array) -> Array:
    return np.array(list(itertools.product(*zip(lower, upper, strict=True))))


def _soft_max(values: Sequence[Array] | Array, axis: int) -> Array:
    return np.logaddexp.reduce(SHARPNESS * np.asarray(values), axis=axis) / SHARPNESS


def _soft_min(values: Sequence[Array] | Array, axis: int) -> Array:
    return -_soft_max(-np.asarray(values), axis)

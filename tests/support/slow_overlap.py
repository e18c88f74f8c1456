"""Algorithm 1 of the paper, literally: loops over geoms and their eight corners."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np

import graceful_plan as gp

Array = np.ndarray


def corners(scene: gp.Scene, data: mujoco.MjData, geom: int) -> list[Array]:
    """Return the corners in W of a geom's box."""
    centre, half = scene.model.geom_aabb[geom, :3], scene.model.geom_aabb[geom, 3:]
    p, R = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    return [p + R @ (centre + half * np.array(signs)) for signs in itertools.product((-1, 1), repeat=3)]


def probability(scene: gp.Scene, q: Array, component: str, entity: str) -> float:
    """Return P for one configuration."""
    data = scene.data_at(q)
    robot = [corners(scene, data, geom) for geom in scene.components[component].geoms]
    hit = [corners(scene, data, geom) for geom in scene.entities[entity].geoms]
    area_r = sum(ground_area(points) for points in robot)
    area_e = sum(ground_area(points) for points in hit)
    area_overlap = 0.0
    for points_r in robot:
        for points_e in hit:
            area_overlap += axis_overlap(points_r, points_e, 0) * axis_overlap(points_r, points_e, 1)
    P = max(area_overlap / area_r, area_overlap / area_e)
    body_r, body_e = list(itertools.chain(*robot)), list(itertools.chain(*hit))
    if min(p[2] for p in body_r) > max(p[2] for p in body_e) or axis_overlap(body_r, body_e, 2) > 0.0:
        return min(P, 1.0)  # clipping is not in the paper
    return 0.0


def ground_area(points: list[Array]) -> float:
    """Return the area of the projection of a box on xy."""
    return float(np.prod([max(p[axis] for p in points) - min(p[axis] for p in points) for axis in (0, 1)]))


def axis_overlap(first: list[Array], second: list[Array], axis: int) -> float:
    """Return the overlap of the extents along an axis."""
    end = min(max(p[axis] for p in first), max(p[axis] for p in second))
    begin = max(min(p[axis] for p in first), min(p[axis] for p in second))
    return max(float(end - begin), 0.0)

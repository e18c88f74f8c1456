"""What each entity looks like: pictures in which it is outlined, from where most of it is seen."""

from __future__ import annotations

import io
from collections.abc import Iterable

import mujoco
import numpy as np

from graceful_plan.array_types import Bool, Float, UInt8
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.offscreen import Canvas, camera_at, canvas

Array = np.ndarray

_WIDTH, _HEIGHT = 384, 288
_AZIMUTHS = tuple(45.0 * i for i in range(8))
_ELEVATIONS = (-20.0, -50.0)
"""Where a camera may stand [degrees]: at each elevation the azimuth counts from which most of the entity is seen."""
_NEAR, _FAR = 3.0, 0.3
"""Distance of the camera: so many half diagonals of the entity, and at least so far [m]."""
_SCOUTED = 4
"""Pixels a side for one pixel of the pictures by which places are compared."""
_OUTLINE = 2
"""Width of the outline [pixels]."""
_RED = (255, 0, 0)


def entity_views(scene: Scene, names: Iterable[str]) -> dict[str, tuple[bytes, ...]] | None:
    """Take two pictures of each entity, from its side and from above, where all stands as the scene has it.

    Args:
        scene: Where they are; the robot is at its first keyframe, if it has one.
        names: Of the entities.

    Returns:
        PNG files by name, none of an entity that something hides from all sides; None where EGL does not work.
    """
    data = scene.data_at(next(iter(scene.keyframes.values()), scene.home_qpos[scene.qpos_adr]))
    with canvas(scene.model, _WIDTH, _HEIGHT) as opened:
        if opened is None:
            return None
        return {name: _views(opened, scene, data, name) for name in names}


def entity_box(scene: Scene, data: mujoco.MjData, name: str) -> Float[Array, "2 xyz"]:
    """Return lower and upper corner of the box along the axes of W around an entity [m]; planes have no box."""
    corners = []
    for geom in scene.entities[name].geoms:
        R_WG = data.geom_xmat[geom].reshape(3, 3)
        aabb = scene.model.geom_aabb[geom]
        middle, half = data.geom_xpos[geom] + R_WG @ aabb[:3], np.abs(R_WG) @ aabb[3:]
        corners += [middle - half, middle + half]
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])


def _views(opened: Canvas, scene: Scene, data: mujoco.MjData, name: str) -> tuple[bytes, ...]:
    box, geoms = entity_box(scene, data, name), scene.entities[name].geoms
    most = max(1.0, float(scene.model.stat.extent))
    middle = np.clip(box.mean(axis=0), scene.model.stat.center - most, scene.model.stat.center + most)
    # A floor is larger than everything that stands on it: it is seen from as far as the whole scene is.
    distance = min(max(_FAR, _NEAR * float(np.linalg.norm(np.diff(box, axis=0))) / 2.0), 2.0 * most)
    found = []
    for elevation in _ELEVATIONS:
        cameras = [camera_at(middle, distance, azimuth, elevation) for azimuth in _AZIMUTHS]
        best = max(cameras, key=lambda camera: int(np.isin(opened.geoms(data, camera, _SCOUTED), geoms).sum()))
        seen = np.isin(opened.geoms(data, best), geoms)
        if seen.any():
            found.append(_png(_outlined(opened.picture(data, best), seen)))
    return tuple(found)


def _outlined(
    pixels: UInt8[Array, "height width 3"], inside: Bool[Array, "height width"]
) -> UInt8[Array, "height width 3"]:
    """Return a picture with a line around what is inside."""
    grown = inside.copy()
    for _ in range(_OUTLINE):
        padded = np.pad(grown, 1)
        grown = padded[1:-1, 1:-1] | padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
    marked = pixels.copy()
    marked[grown & ~inside] = _RED
    return marked


def _png(pixels: UInt8[Array, "height width 3"]) -> bytes:
    from matplotlib.image import imsave

    file = io.BytesIO()
    imsave(file, pixels, format="png")
    return file.getvalue()

"""Pictures of each entity with its outline marked, from the camera pose that shows most of it."""

from __future__ import annotations

import io
from collections.abc import Iterable

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float, UInt8
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.offscreen import Canvas, camera_at, canvas

_WIDTH, _HEIGHT = 384, 288
_AZIMUTHS = tuple(45.0 * i for i in range(8))
_ELEVATIONS = (-20.0, -50.0)
"""Camera angles [degrees]: for each elevation, the azimuth that shows most of the entity is used."""
_NEAR, _FAR = 3.0, 0.3
"""Distance of the camera in half diagonals of the entity, and its minimum [m]."""
_SCOUTED = 4
"""Factor by which images for comparing camera angles are smaller on each side."""
_OUTLINE = 2
"""Width of the outline [pixels]."""
_RED = (255, 0, 0)


def entity_views(scene: Scene, names: Iterable[str]) -> dict[str, tuple[bytes, ...]] | None:
    """Render two pictures of each entity, from the side and from above.

    Args:
        scene: Scene with the entities; the robot is at its first keyframe, if there is one.
        names: Names of the entities.

    Returns:
        PNG files by name, none for an entity hidden from all sides; None if EGL does not work.
    """
    data = scene.data_at(next(iter(scene.keyframes.values()), scene.home_qpos[scene.qpos_adr]))
    with canvas(scene.model, _WIDTH, _HEIGHT) as opened:
        if opened is None:
            return None
        return {name: _views(opened, scene, data, name) for name in names}


def entity_box(scene: Scene, data: mujoco.MjData, name: str) -> Float[Array, "2 xyz"]:
    """Return lower and upper corner of the axis-aligned box of an entity in W [m]; unbounded for a plane."""
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
    # A floor is larger than the scene: view it from the distance of the whole scene.
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
    """Return a picture with a line around a region."""
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

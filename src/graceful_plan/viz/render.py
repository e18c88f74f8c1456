"""Camera view of a scene and paths; optional, because it needs off-screen rendering."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path as FilePath
from typing import Any

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.footprints import object_positions
from graceful_plan.viz.offscreen import camera_at, canvas
from graceful_plan.viz.style import PATH_COLOURS

_WIDTH, _HEIGHT = 1600, 1000
_DISTANCE, _AZIMUTH, _ELEVATION = 1.35, 65.0, -42.0
"""Camera pose around the centroid of the paths [m, degrees]."""
_RADIUS = 0.006
_STEP = 0.05


def render_paths(scene: Scene, paths: Mapping[str, Path], file: str | FilePath) -> bool:
    """Render the robot at the start, with the paths of the carried object as tubes.

    Args:
        scene: Scene of the paths.
        paths: Paths by label, coloured as in `figures.compare_paths`.
        file: PNG file to write.

    Returns:
        Whether the picture was written; False if EGL does not work.
    """
    from matplotlib.image import imsave

    with canvas(scene.model, _WIDTH, _HEIGHT) as drawn_on:
        if drawn_on is None:
            return False
        positions = [object_positions(scene, path.resampled(_STEP)) for path in paths.values()]

        def tubes(view: Any) -> None:
            for position, colour in zip(positions, PATH_COLOURS, strict=False):
                _add_tube(view, position, colour)

        data = scene.data_at(next(iter(paths.values())).q[0])
        middle = np.concatenate(positions).mean(axis=0)
        imsave(file, drawn_on.picture(data, camera_at(middle, _DISTANCE, _AZIMUTH, _ELEVATION), tubes))
    return True


def _add_tube(view: Any, position: Float[Array, "n 3"], colour: str) -> None:
    """Append capsules between neighbouring points to the rendered scene."""
    rgba = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)] + [1.0], dtype=np.float32)
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE
    for a, b in pairwise(position):
        geom = view.geoms[view.ngeom]
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
        mujoco.mjv_connector(geom, kind, _RADIUS, a, b)
        view.ngeom += 1

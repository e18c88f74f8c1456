"""Off-screen pictures of a scene; optional, because they need OpenGL with EGL."""

from __future__ import annotations

import copy
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int, UInt8

_MOST = 10_000
"""Maximum number of geoms in a picture."""
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_SEGMENT = (int(mujoco.mjtRndFlag.mjRND_SEGMENT), int(mujoco.mjtRndFlag.mjRND_IDCOLOR))


class Canvas:
    """Off-screen renderer of a model, opened by `canvas`."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model = copy.copy(model)
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = width, height
        self._model.vis.quality.offsamples = 8
        self._model.vis.headlight.ambient[:], self._model.vis.headlight.diffuse[:] = 0.4, 0.55
        self._view = mujoco.MjvScene(self._model, maxgeom=_MOST)
        self.renderer = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_150)
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self.renderer)
        self._size = width, height

    def picture(
        self, data: mujoco.MjData, camera: mujoco.MjvCamera, mark: Callable[[Any], None] | None = None
    ) -> UInt8[Array, "height width 3"]:
        """Render a picture; `mark` may add geoms to the MjvScene."""
        self._place(data, camera)
        if mark is not None:
            mark(self._view)
        return self._pixels()

    def geoms(self, data: mujoco.MjData, camera: mujoco.MjvCamera, shrink: int = 1) -> Int[Array, "height width"]:
        """Return the visible geom at each pixel, -1 for none, at a resolution divided by `shrink`."""
        self._place(data, camera)
        self._view.flags[list(_SEGMENT)] = 1
        try:
            colour = self._pixels(shrink).astype(np.int64)
        finally:
            self._view.flags[list(_SEGMENT)] = 0
        shown = colour[..., 0] + 256 * colour[..., 1] + 65536 * colour[..., 2]
        geom_of = np.full(_MOST + 1, -1)
        for drawn in self._view.geoms[: self._view.ngeom]:
            if drawn.objtype == _GEOM and drawn.segid >= 0:
                geom_of[drawn.segid + 1] = drawn.objid
        return geom_of[np.minimum(shown, _MOST)]

    def _place(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> None:
        mujoco.mjv_updateScene(
            m=self._model,
            d=data,
            opt=mujoco.MjvOption(),
            pert=mujoco.MjvPerturb(),
            cam=camera,
            catmask=int(mujoco.mjtCatBit.mjCAT_ALL),
            scn=self._view,
        )

    def _pixels(self, shrink: int = 1) -> UInt8[Array, "height width 3"]:
        viewport = mujoco.MjrRect(0, 0, self._size[0] // shrink, self._size[1] // shrink)
        mujoco.mjr_render(viewport, self._view, self.renderer)
        pixels = np.zeros((viewport.height, viewport.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, viewport, self.renderer)
        return pixels[::-1]


@contextmanager
def canvas(model: mujoco.MjModel, width: int, height: int) -> Generator[Canvas | None]:
    """Open an off-screen renderer of a size [pixels]; None if EGL does not work."""
    context = _context(width, height)
    if context is None:
        yield None
        return
    try:
        context.make_current()
        opened = Canvas(model, width, height)
        try:
            yield opened
        finally:
            opened.renderer.free()
    finally:
        context.free()


def camera_at(point: Float[Array, " xyz"], distance: float, azimuth: float, elevation: float) -> mujoco.MjvCamera:
    """Return a camera aimed at a point in W [m], from a distance [m] and angles [degrees]."""
    camera = mujoco.MjvCamera()
    camera.lookat[:] = point
    camera.distance, camera.azimuth, camera.elevation = distance, azimuth, elevation
    return camera


def _context(width: int, height: int) -> Any:
    try:
        from mujoco.egl import GLContext

        return GLContext(width, height)
    except (ImportError, AttributeError, OSError, RuntimeError):
        return None

"""Pictures of a simulation without a window.

On import, MuJoCo chooses an OpenGL backend that needs a display, unless MUJOCO_GL says otherwise. This module chooses
the backend when the first picture is taken: the one named by MUJOCO_GL, else EGL, which needs no display. It sets no
environment variable.
"""

from __future__ import annotations

import copy
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

import mujoco
import numpy as np

from failbench.basics.errors import NoPicture
from graceful_plan.array_types import Array, Bool, UInt8
from graceful_plan.exceptions import UnknownNameError

Mark = Callable[[Any], None]
"""Adds geoms to an MjvScene."""

_AZIMUTH, _ELEVATION = 120.0, -35.0
"""View angles if the scene has no camera [degrees]."""
_SHINE = 0.85
"""Opacity of marks."""
_MOST = 10_000
"""Greatest number of geoms in a picture."""
_SHADOW = 2048
"""Resolution of shadows; without a graphics card, finer ones take longer than the rest of the picture."""
_SMOOTHING = 4
"""Samples per pixel."""


def has_display() -> bool:
    """Return whether a window can be opened."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def find_camera(model: mujoco.MjModel, camera: str | mujoco.MjvCamera | None) -> mujoco.MjvCamera:
    """Return the named camera; for None the camera "overview", or else one that sees the whole scene.

    Raises:
        UnknownNameError: If the scene has no such camera.
    """
    if isinstance(camera, mujoco.MjvCamera):
        return camera
    names = [model.camera(i).name for i in range(model.ncam)]
    if camera is not None and camera not in names:
        raise UnknownNameError("camera", camera, names)
    found = mujoco.MjvCamera()
    name = "overview" if camera is None else camera
    if name in names:
        found.type, found.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, names.index(name)
    else:
        mujoco.mjv_defaultFreeCamera(model, found)
        found.azimuth, found.elevation = _AZIMUTH, _ELEVATION
    return found


class Offscreen:
    """Renderer for pictures without a window. Use it in a `with` statement.

    `model` is a copy for painting: pictures use its colours.

    Args:
        model: Model of the scene.
        width: Width of the pictures [pixels].
        height: Height of the pictures [pixels].

    Raises:
        NoPicture: If no OpenGL works without a window.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._gl = _context(width, height)
        self.model = copy.copy(model)
        self.model.vis.global_.offwidth, self.model.vis.global_.offheight = width, height
        self.model.vis.quality.offsamples = _SMOOTHING
        self.model.vis.quality.shadowsize = min(_SHADOW, self.model.vis.quality.shadowsize)
        self._view = mujoco.MjvScene(self.model, maxgeom=_MOST)
        self._marks = mujoco.MjvScene(self.model, maxgeom=_MOST)
        self._marks.flags[:] = 0  # only the marks, on black
        self._renderer = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_150)
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self._renderer)
        self._viewport = mujoco.MjrRect(0, 0, width, height)

    def picture(self, data: mujoco.MjData, camera: mujoco.MjvCamera, *marks: Mark) -> UInt8[Array, "height width 3"]:
        """Take a picture with marks drawn over it; nothing hides them."""
        pixels = self._render(self._view, data, camera, int(mujoco.mjtCatBit.mjCAT_ALL))
        drawn = self._render(self._marks, data, camera, 0, marks)
        marked = drawn.max(axis=2) > 0
        pixels[marked] = _SHINE * drawn[marked] + (1.0 - _SHINE) * pixels[marked]
        return pixels

    def silhouette(self, data: mujoco.MjData, camera: mujoco.MjvCamera, mark: Mark) -> Bool[Array, "height width"]:
        """Return the pixels that a mark covers."""
        return self._render(self._marks, data, camera, 0, [mark]).max(axis=2) > 0

    def _render(
        self,
        view: mujoco.MjvScene,
        data: mujoco.MjData,
        camera: mujoco.MjvCamera,
        categories: int,
        marks: Sequence[Mark] = (),
    ) -> UInt8[Array, "height width 3"]:
        option, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        mujoco.mjv_updateScene(m=self.model, d=data, opt=option, pert=perturb, cam=camera, catmask=categories, scn=view)
        for mark in marks:
            mark(view)
        self._gl.make_current()
        mujoco.mjr_render(self._viewport, view, self._renderer)
        pixels = np.zeros((self._viewport.height, self._viewport.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._renderer)
        return pixels[::-1]

    def __enter__(self) -> Offscreen:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._gl.make_current()
        self._renderer.free()
        self._gl.free()


def _context(width: int, height: int) -> Any:
    """Return a current OpenGL context."""
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    named = {"egl": "mujoco.egl", "osmesa": "mujoco.osmesa"}
    if wanted:
        modules = [named.get(wanted, "mujoco.gl_context")]
    else:
        modules = ["mujoco.egl"] * sys.platform.startswith("linux") + ["mujoco.gl_context"] * has_display()
    problems = []
    for name in modules:
        try:
            context = importlib.import_module(name).GLContext(width, height)
            context.make_current()
            return context
        except Exception as error:  # backends raise different errors
            problems.append(f"{name}: {type(error).__name__}: {error}")
    raise NoPicture(
        "no OpenGL works here without a window (" + "; ".join(problems) + ")",
        "install EGL (Debian, Ubuntu: libegl1) and set MUJOCO_GL=egl",
    )

"""Timing limits of a mobile base: along and across its heading, and of its wheels."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.optional import import_mobile
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.topp import Restraint

DriveLimits = Callable[[DiffDrive, CurveGrid], Float[Array, "interval limit 3"]]
"""Maps a base and a curve to limits a u + b x <= c on path acceleration u and squared path speed x."""


def base_limits(scene: Scene) -> Restraint | None:
    """Return the limits of a scene's base on path acceleration and speed; None for a robot without a base.

    Raises:
        UnsupportedError: If the scene has a base and the optional modules for mobile bases are not installed.
    """
    if scene.base is None:
        return None
    limits: DriveLimits = import_mobile("motions.drive_limits").drive_limits
    return partial(limits, scene.base)

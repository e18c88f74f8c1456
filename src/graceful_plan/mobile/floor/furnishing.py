"""Build scenes from floor maps: a bundled robot with a base, boxes for occupied cells, and entities."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Bool
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.edit import StaticBody
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.loading.robot_models import robot_file
from graceful_plan.scene.mobile.known_bases import known_base
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.sensed.boxes import MOST_BOXES, joined
from graceful_plan.setting_checks import positive

_FLOOR, _WALLS = "floor", "walls"
_BORDER = 0.1
"""Thickness of the walls around the map [m]."""
_TOOLS = {"jackal": "jackal/base", "fetch": "fetch/tool"}


def furnished(
    occupied: Bool[Array, "row column"],
    resolution: float,
    origin: tuple[float, float, float],
    *,
    solids: Sequence[StaticBody],
    robot: str,
    height: float,
    severity: Mapping[str, Any] | str | Path | None,
    keyframes: Mapping[str, ArrayLike] | None,
    name: str,
) -> Scene:
    """Build a scene with a robot on a floor.

    Raises:
        UnknownNameError: If there is no such robot with a base, or no such class.
        SettingError: If there are too many boxes, or a height is not above 0.
    """
    base = known_base(robot)
    positive("height", height, "a finite height of occupied cells above 0 [m]")
    rows, columns = occupied.shape
    x, y, yaw = origin
    size = np.array([columns, rows]) * resolution
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.option.timestep, spec.option.integrator = 0.002, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    turn = [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]
    floor = spec.worldbody.add_body(name=_FLOOR, pos=[x, y, 0.0], quat=turn)
    half = [*(0.5 * size + _BORDER).tolist(), 0.05]
    middle = [*(0.5 * size).tolist(), -0.05]
    floor.add_geom(name=_FLOOR, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=middle, rgba=[0.8, 0.79, 0.76, 1.0])
    walls = spec.worldbody.add_body(name=_WALLS, pos=[x, y, 0.0], quat=turn)
    lower, upper = _boxes(occupied, resolution)
    for a, b in zip(lower.tolist(), upper.tolist(), strict=True):
        _add(walls, a, b, height)
    for a, b in _border(size):
        _add(walls, a, b, height)
    for solid in solids:
        solid.add_to(spec)
    model = mujoco.MjSpec.from_file(str(robot_file(robot)))
    spec.attach(model, prefix=f"{robot}/", frame=spec.worldbody.add_frame())
    limits = _limits(size, origin)
    return Scene.from_mjcf(
        spec,
        robot=f"{robot}/",
        tool=_TOOLS[robot],
        base=base,
        body_class="base_coast",
        entities={solid.name: solid.entity for solid in solids if solid.entity is not None},
        severity=severity,
        limits={base.joints[0]: limits[0], base.joints[1]: limits[1]},
        allowed_contacts=[AllowedContact(f"{robot}/base", _FLOOR)],
        keyframes=keyframes,
        name=name,
    )


def _boxes(occupied: Bool[Array, "row column"], resolution: float) -> tuple[Array, Array]:
    """Return corners in the frame of the map [m] of few boxes that cover exactly the occupied cells."""
    row, column = np.nonzero(occupied)
    if not len(row):
        return np.zeros((0, 2)), np.zeros((0, 2))
    first, last = joined(np.stack([column, row, np.zeros_like(row)], axis=1))
    if len(first) > MOST_BOXES:
        raise SettingError("map", f"so irregular that it gives {len(first)} boxes", f"{MOST_BOXES} at most")
    return first[:, :2] * resolution, last[:, :2] * resolution


def _border(size: Array) -> list[tuple[list[float], list[float]]]:
    (w, h), t = size.tolist(), _BORDER
    return [([-t, -t], [0.0, h + t]), ([w, -t], [w + t, h + t]), ([0.0, -t], [w, 0.0]), ([0.0, h], [w, h + t])]


def _add(body: mujoco.MjsBody, lower: Sequence[float], upper: Sequence[float], height: float) -> None:
    centre = [0.5 * (a + b) for a, b in zip(lower, upper, strict=True)]
    half = [0.5 * (b - a) for a, b in zip(lower, upper, strict=True)]
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[*half, 0.5 * height],
        pos=[*centre, 0.5 * height],
        rgba=[0.85, 0.84, 0.82, 1.0],
    )


def _limits(size: Array, origin: tuple[float, float, float]) -> list[tuple[float, float]]:
    """Return the least and greatest x and y of the map in W [m]."""
    x, y, yaw = origin
    c, s = math.cos(yaw), math.sin(yaw)
    corners = np.array([[0.0, 0.0], [size[0], 0.0], [0.0, size[1]], size]) @ np.array([[c, s], [-s, c]]) + (x, y)
    return list(zip(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), strict=True))

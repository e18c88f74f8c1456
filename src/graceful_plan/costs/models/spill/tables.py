"""Scene data of the spill model beyond the tables of the drop model: the container, and the supports of targets.

Frames: W world, L the link of the tool.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.frames import reference_data
from graceful_plan.costs.models.drop.tables import DropTables, drop_tables
from graceful_plan.scene.elements import Granular
from graceful_plan.scene.per_scene import per_layout, per_scene
from graceful_plan.scene.scene import Scene

DEPTH = 0.002
"""Depth of a puddle [m]: water at a contact angle of 45 degrees stands at 2.1 mm."""
REPOSE = float(np.deg2rad(33.0))
"""Slope at which dry contents begin to slide [rad]."""
STANDS = 0.01
"""Largest height of a thing's bottom above a surface on which it stands [m]."""
FLAT = 1e-3
"""Height of a thing's top above a surface up to which it is part of that surface [m]."""
EDGE = 0.02
"""Height difference from which a top shields things below it [m]."""
_GRID = 7
_ROWS = 256
"""Number of targets compared with all others at once, which limits memory."""


@final
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SpillTables:
    """Tables of the spill model; targets and levels are those of `DropTables`.

    | field   | meaning                                                                     | unit | shape    |
    |---------|-----------------------------------------------------------------------------|------|----------|
    | mouth   | centre of the contents' surface, from the object's centre of mass, in L     | m    | 3        |
    | axis    | from the container's bottom to its rim, in L                                |      | 3        |
    | rim     | r: radius of the container                                                  | m    |          |
    | depth   | H: height of its rim above its bottom                                       | m    |          |
    | full    | ratio of the container's capacity to the contents                           |      |          |
    | radius  | R: radius of the puddle or heap of all contents                             | m    |          |
    | power   | exponent of the volume in the radius                                        |      |          |
    | repose  | tangent of the slope at which contents stand; 0 for liquids                 |      |          |
    | visible | share of a target in top view that no much higher target covers             |      | target   |
    | stands  | first level that a target stands on or beside, and one past the last        |      | target 2 |
    """

    mouth: Float[Array, " 3"]
    axis: Float[Array, " 3"]
    rim: float
    depth: float
    full: float
    radius: float
    power: float
    repose: float
    visible: Float[Array, " target"]
    stands: Int[Array, "target 2"]


@per_scene
def spill_tables(scene: Scene) -> SpillTables:
    """Return the tables of a scene with a carried object that has contents; they are cached per scene.

    Raises:
        UnsupportedError: If the scene cannot be compiled.
    """
    assert scene.carried is not None  # tables are only built for a carried object
    assert scene.contents is not None
    tables, contents = drop_tables(scene), scene.contents
    mouth, axis, rim, depth = _container(scene)
    room, volume = np.pi * rim**2 * depth, 1e-3 * contents.volume
    volume, dry = min(volume, room), isinstance(contents, Granular)
    return SpillTables(
        mouth=mouth - tables.centre,
        axis=axis,
        rim=rim,
        depth=depth,
        full=room / volume,
        radius=float(np.cbrt(3.0 * volume / (np.pi * np.tan(REPOSE))) if dry else np.sqrt(volume / (np.pi * DEPTH))),
        power=1.0 / 3.0 if dry else 0.5,
        repose=float(np.tan(REPOSE)) if dry else 0.0,
        visible=_visible(tables),
        stands=_stands(tables),
    )


@per_layout
def _container(scene: Scene) -> tuple[Float[Array, " 3"], Float[Array, " 3"], float, float]:
    """Return the centre of the contents' surface and the axis in L, and the container's radius and depth [m].

    The geom of the contents gives bottom and radius, round about its z axis. The rim is the top of the highest geom of
    the carried object that is round about the same axis: a bottle's neck, but not a teapot's handle. Lids are off.
    """
    assert scene.carried is not None
    model = scene.model
    data = reference_data(scene)
    body = model.body(scene.carried.body).id
    geom = max(scene.components["contents"].geoms, key=lambda g: float(np.prod(model.geom_aabb[g, 3:])))
    R_WO, half = data.xmat[body].reshape(3, 3), model.geom_aabb[geom, 3:]
    R_WG = data.geom_xmat[geom].reshape(3, 3)
    axis = R_WG[:, 2] * (1.0 if R_WO[:, 2] @ R_WG[:, 2] >= 0.0 else -1.0)
    centre = data.geom_xpos[geom] + R_WG @ model.geom_aabb[geom, :3]
    bottom = centre - half[2] * axis
    boxy = int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_BOX)
    rim = float(2.0 * np.sqrt(half[0] * half[1] / np.pi)) if boxy else float(half[:2].max())
    tops = [_top(model, data, g, bottom, axis, rim) for g in scene.components["carried"].geoms]
    X_LO = compile_scene(scene).robot.X_LT @ scene.carried.X_TO
    place = R_WO.T @ (centre + half[2] * axis - data.xpos[body])
    return (
        X_LO[:3, :3] @ place + X_LO[:3, 3],
        X_LO[:3, :3] @ (R_WO.T @ axis),
        rim,
        max(2.0 * float(half[2]), *tops),
    )


def _top(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, bottom: Array, axis: Float[Array, " 3"], rim: float
) -> float:
    """Return the height of a geom's top above the bottom; 0 if it is not round about the axis."""
    R, half = data.geom_xmat[geom].reshape(3, 3), model.geom_aabb[geom, 3:]
    offset = data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3] - bottom
    along = float(offset @ axis)
    across = np.abs(R.T @ axis)
    wide = half[across < 0.5]
    aside = float(np.linalg.norm(offset - along * axis))
    if aside > 0.25 * rim or across.max() < 0.9 or wide.min() < 0.5 * wide.max():
        return 0.0
    return along + float(half @ across)


def _visible(tables: DropTables) -> Float[Array, " target"]:
    step = (np.arange(_GRID) + 0.5) / _GRID * 2.0 - 1.0
    grid = np.stack([axis.ravel() for axis in np.meshgrid(step, step)], axis=1)
    share = np.ones(len(tables.target_entity))
    turn = np.stack([tables.target_axis, tables.target_axis[:, ::-1] * [-1.0, 1.0]], axis=1)  # rows: x, y axis
    centre, half, top = tables.target_centre, tables.target_half, tables.target_height[:, 1]
    below, above = _near(centre, half, top)
    if not len(below):
        return share
    points = centre[:, None] + (grid * half[:, None]) @ turn
    away = points[below] - centre[above, None]
    covers = np.ones(away.shape[:2], dtype=bool)
    for axis in (0, 1):  # written out: a stack of small matrix products takes ten times as long
        x, y = turn[above, axis].T[:, :, None]
        covers &= np.abs(away[:, :, 0] * x + away[:, :, 1] * y) < half[above, axis, None]
    covered, first = np.unique(below, return_index=True)
    share[covered] -= np.logical_or.reduceat(covers, first).mean(axis=1)
    return share


def _near(
    centre: Float[Array, "target 2"], half: Float[Array, "target 2"], top: Float[Array, " target"]
) -> tuple[Int[Array, " pair"], Int[Array, " pair"]]:
    """Return pairs of a target and a much higher one that may cover a part of it, ordered by the first."""
    reach, pairs = np.linalg.norm(half, axis=1), [np.zeros((0, 2), dtype=int)]
    for begin in range(0, len(top), _ROWS):
        rows = slice(begin, begin + _ROWS)
        away = np.square(centre[rows, None] - centre).sum(axis=2)
        met = (top > top[rows, None] + EDGE) & (away <= np.square(reach[rows, None] + reach))
        pairs.append(np.argwhere(met) + [begin, 0])
    below, above = np.concatenate(pairs).T
    return below, above


def _stands(tables: DropTables) -> Int[Array, "target 2"]:
    level = tables.target_height[tables.level_start[:-1], 1]  # decreases from level to level
    bottom, top = tables.target_height.T
    first = (level[None] >= (top - FLAT)[:, None]).sum(axis=1)
    end = (level[None] > (bottom - STANDS)[:, None]).sum(axis=1)
    return np.stack([first, np.maximum(first, end)], axis=1)

"""Compute floor maps from scenes: which cells are occupied between two heights.

Each cell is a box of its width between the heights; MuJoCo computes its exact distance to each geom.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.floor.files.map_server import RESOLUTIONS
from graceful_plan.path import finite_array, is_real
from graceful_plan.scene import roles
from graceful_plan.scene.scene import Scene

_PROBE = "floor_map_probe"
_AROUND = 1
"""Number of free cells around the cut geometry."""


def sliced(
    scene: Scene, heights: tuple[float, float], resolution: float, bounds: Sequence[float] | None, most_cells: int
) -> tuple[Bool[Array, "row column"], tuple[float, float]]:
    """Return the occupied cells, and the position of the lower left corner in W [m].

    Raises:
        SettingError: If a setting is out of its range, nothing is cut, or there would be too many cells.
    """
    low, high = finite_array("heights", np.asarray(heights), ndim=1, last=2).tolist()
    if not low < high:
        raise SettingError("heights", heights, "the lower one first [m]")
    least, most = RESOLUTIONS
    if not (is_real(resolution) and least <= resolution <= most):
        raise SettingError("resolution", resolution, f"a width of a cell from {least:g} to {most:g} m")
    model, data, probe = _with_probe(scene, resolution, high - low)
    kept = scene.robot_bodies | roles.held_bodies(scene.model, scene.notes)
    geoms = [
        geom
        for geom in range(scene.model.ngeom)
        if int(scene.model.geom_bodyid[geom]) not in kept
        and (scene.model.geom_contype[geom] or scene.model.geom_conaffinity[geom])
        and scene.model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE
    ]
    boxes = {geom: _extent(model, data, geom) for geom in geoms}
    cut = {geom: box for geom, box in boxes.items() if box[0, 2] < high and box[1, 2] > low}
    corner, (columns, rows) = _area(cut, resolution, bounds, most_cells)
    occupied = np.zeros((rows, columns), dtype=bool)
    for geom, box in cut.items():
        first = np.maximum(np.floor((box[0, :2] - corner) / resolution).astype(int), 0)
        last = np.minimum(np.ceil((box[1, :2] - corner) / resolution).astype(int), (columns, rows))
        if (first >= last).any():
            continue
        part = occupied[first[1] : last[1], first[0] : last[0]]
        middle = corner + (np.stack(np.meshgrid(*map(np.arange, first, last)), axis=-1) + 0.5) * resolution
        upright = _upright(model, data, geom, middle, 0.5 * resolution - 1e-6)
        if upright is not None:
            part |= upright
            continue
        for row, column in np.argwhere(~part):
            data.geom_xpos[probe] = [*middle[row, column], 0.5 * (low + high)]
            # A cell that a geom only touches is occupied.
            part[row, column] = mujoco.mj_geomDistance(model, data, probe, geom, 1.0, None) <= 0.0
    return occupied, (float(corner[0]), float(corner[1]))


def _with_probe(scene: Scene, resolution: float, height: float) -> tuple[mujoco.MjModel, mujoco.MjData, int]:
    spec = scene.spec.copy()
    # Slightly smaller, so that a geom that ends at the border of a cell does not occupy the next one.
    half = [0.5 * resolution - 1e-6, 0.5 * resolution - 1e-6, 0.5 * height]
    body = spec.worldbody.add_body(name=_PROBE)
    body.add_geom(name=_PROBE, type=mujoco.mjtGeom.mjGEOM_BOX, size=half)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = scene.home_qpos
    mujoco.mj_kinematics(model, data)
    names = [model.geom(k).name for k in range(model.ngeom)]
    # Body ids follow the order of the tree, so the probe, added last to the world, has the last geom.
    probe = names.index(_PROBE)
    assert probe == model.ngeom - 1
    return model, data, probe


def _upright(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, middle: Float[Array, "row column 2"], half: float
) -> Bool[Array, "row column"] | None:
    """Return which cells an upright box or cylinder touches; None for other geoms."""
    R, kind = data.geom_xmat[geom].reshape(3, 3), model.geom_type[geom]
    if abs(R[2, 2]) < 1.0 - 1e-12 or kind not in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER):
        return None
    away = middle - data.geom_xpos[geom, :2]
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.linalg.norm(np.maximum(np.abs(away) - half, 0.0), axis=-1) <= model.geom_size[geom, 0]
    # Two rectangles are disjoint if a side of either separates them.
    turn, size = R[:2, :2], model.geom_size[geom, :2]
    mine = np.abs(away @ turn) <= size + half * np.abs(turn).sum(axis=0)
    cell = np.abs(away) <= np.abs(turn) @ size + half
    return (mine & cell).all(axis=-1)


def _extent(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Float[Array, "2 3"]:
    """Return the lower and upper corners of the axis-aligned bounding box of a geom in W."""
    R, centre = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    aabb = model.geom_aabb[geom]
    middle, half = centre + R @ aabb[:3], np.abs(R) @ aabb[3:]
    return np.stack([middle - half, middle + half])


def _area(
    cut: dict[int, Float[Array, "2 3"]], resolution: float, bounds: Sequence[float] | None, most_cells: int
) -> tuple[Float[Array, " 2"], tuple[int, int]]:
    if bounds is not None:
        area = finite_array("bounds", np.asarray(bounds), ndim=1, last=4).reshape(2, 2)
        if not np.all(area[:, 0] < area[:, 1]):
            raise SettingError("bounds", bounds, "least x, greatest x, least y, greatest y [m]")
        low, high = area[:, 0], area[:, 1]
    else:
        if not cut:
            raise SettingError("bounds", None, "least x, greatest x, least y, greatest y [m]: nothing at that height")
        low = np.min([box[0, :2] for box in cut.values()], axis=0) - _AROUND * resolution
        high = np.max([box[1, :2] for box in cut.values()], axis=0) + _AROUND * resolution
    counts = np.maximum(np.ceil((high - low) / resolution - 1e-9), 1.0)
    if counts.prod() > most_cells:
        raise SettingError(
            "resolution", resolution, f"wider cells: these are {counts.prod():.3g}, at most {most_cells}"
        )
    return low, (int(counts[0]), int(counts[1]))

"""Merge occupied grid cells into a small set of boxes that covers exactly these cells."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real
from graceful_plan.scene.loading.naming import check_new

_ORDERS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""Axis orders in which cells are merged into rows, plates and blocks; the order with the fewest boxes is used."""
MOST_BOXES = 20_000
"""Largest number of boxes per body: MuJoCo takes seconds for more."""
FARTHEST = 500.0
"""Largest distance from the origin of W [m], far beyond any robot's reach; it keeps cell indices small."""
_LEAST, _MOST = 1e-4, 100.0


def check_width(name: str, value: object) -> None:
    """Raise SettingError if a value is not a valid cell width [m]."""
    if not (is_real(value) and _LEAST <= value <= _MOST):
        raise SettingError(name, value, f"a width above 0, {_LEAST:g} to {_MOST:g} m")


def closed(full: Bool[Array, "x y z"]) -> Bool[Array, "x y z"]:
    """Close gaps of up to two cells between occupied cells: dilate by one cell in all directions, then erode."""
    grown = full
    for grow in (True, False):
        for axis in range(3):
            grown = _grown(grown, axis) if grow else ~_grown(~grown, axis)
    return grown


def _grown(full: Bool[Array, "x y z"], axis: int) -> Bool[Array, "x y z"]:
    """Dilate occupied cells by one along an axis; cells outside the grid are ignored."""
    cells, found = np.moveaxis(full, axis, 0), full.copy()
    view = np.moveaxis(found, axis, 0)
    view[1:] |= cells[:-1]
    view[:-1] |= cells[1:]
    return found


def joined(cells: Int[Array, "cell axis"]) -> tuple[Int[Array, "box axis"], Int[Array, "box axis"]]:
    """Return the first cells of boxes and the cells after their last ones; the boxes partition the given cells.

    Args:
        cells: Indices of the occupied cells, each once.
    """
    found = [_joined(cells, np.array(order)) for order in _ORDERS]
    return min(found, key=lambda boxes: len(boxes[0]))


def _joined(cells: Int[Array, "cell 3"], order: Int[Array, " 3"]) -> tuple[Int[Array, "box 3"], Int[Array, "box 3"]]:
    first, last = cells, cells + 1
    for axis in order.tolist():
        others = [k for k in range(3) if k != axis]
        key = np.concatenate([first[:, [axis]], first[:, others], last[:, others]], axis=1)
        place = np.lexsort(key.T)
        first, last = first[place], last[place]
        goes_on = first[1:, axis] == last[:-1, axis]
        goes_on &= (first[1:, others] == first[:-1, others]).all(axis=1)
        goes_on &= (last[1:, others] == last[:-1, others]).all(axis=1)
        begins = np.flatnonzero(np.append(True, ~goes_on))
        ends = np.append(begins[1:], len(first)) - 1
        end = last[ends, axis]
        first, last = first[begins], last[begins].copy()
        last[:, axis] = end
    return first, last


def add_boxes(
    spec: mujoco.MjSpec, name: str, lower: Float[Array, "box 3"], upper: Float[Array, "box 3"], finer: str
) -> None:
    """Add a body at the origin of W that consists of boxes aligned with W.

    Args:
        spec: The MjSpec to change.
        name: Name of the body.
        lower: Lower corners [m].
        upper: Upper corners [m].
        finer: Name of the setting to increase if there are too many boxes.

    Raises:
        SceneError: If the name is taken.
        SettingError: If there are more than `MOST_BOXES`.
    """
    check_new(spec, name)
    if len(lower) > MOST_BOXES:
        raise SettingError(f"{finer} of {name}", f"so fine that it gives {len(lower)} boxes", f"{MOST_BOXES} at most")
    body = spec.worldbody.add_body(name=name)
    for centre, half in zip((0.5 * (lower + upper)).tolist(), (0.5 * (upper - lower)).tolist(), strict=True):
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half)

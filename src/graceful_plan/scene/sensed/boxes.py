"""From cells of a grid that are full to few boxes that cover exactly these."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real
from graceful_plan.scene.loading.naming import check_new

Array = np.ndarray

_ORDERS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""In which cells are joined to rows, rows to plates and plates to blocks; the one with the fewest boxes counts."""
MOST_BOXES = 20_000
"""Of one body: MuJoCo takes seconds for more."""
FARTHEST = 500.0
"""From the origin of W: beyond is no place for a robot, and indices of cells stay small [m]."""
_LEAST, _MOST = 1e-4, 100.0


def check_width(name: str, value: object) -> None:
    """Raise a SettingError if something is no width that cells may have [m]."""
    if not (is_real(value) and _LEAST <= value <= _MOST):
        raise SettingError(name, value, f"a width above 0, {_LEAST:g} to {_MOST:g} m")


def closed(full: Bool[Array, "x y z"]) -> Bool[Array, "x y z"]:
    """Return the full cells of a grid, and those in gaps of up to two: grown by one cell to all sides, and shrunk."""
    grown = full
    for grow in (True, False):
        for axis in range(3):
            grown = _grown(grown, axis) if grow else ~_grown(~grown, axis)
    return grown


def _grown(full: Bool[Array, "x y z"], axis: int) -> Bool[Array, "x y z"]:
    """Grow full cells by one along an axis; outside of the grid nothing is known."""
    cells, found = np.moveaxis(full, axis, 0), full.copy()
    view = np.moveaxis(found, axis, 0)
    view[1:] |= cells[:-1]
    view[:-1] |= cells[1:]
    return found


def joined(cells: Int[Array, "cell axis"]) -> tuple[Int[Array, "box axis"], Int[Array, "box axis"]]:
    """Return the first cells of boxes, and the cells after their last ones; each cell is in one box, and no other is.

    Args:
        cells: Indices of the full ones, each once.
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
    """Add a body at the origin of W that consists of boxes along the axes of W.

    Args:
        spec: What to change.
        name: Of the body.
        lower: Corners [m].
        upper: Opposite corners [m].
        finer: The setting that is to be increased if there are too many of them.

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

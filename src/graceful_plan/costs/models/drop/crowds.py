"""Simplification of bodies with very many boxes, such as point clouds, to a few surfaces for the drop model.

The drop model evaluates every surface in every state. In a scene with many surfaces, a body of a thousand boxes is
therefore replaced by a coarse height map of its tops, in which cells of equal height are joined.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.scene.sensed.boxes import joined

MAX_BOXES = 24
"""Number of surfaces up to which a body is kept as it is in a scene with more than `MOST` surfaces."""
MOST, _LEAST = 192, 12
"""Number of surfaces up to which a scene is kept as it is, and the budget of all crowds together beyond; the least
budget of one crowd."""
_WIDTH = 0.04
"""Initial width of a cell [m]: a little less than a typical carried object."""
_COARSER = 1.4
_STEP = 0.01
"""Initial resolution of the height of tops, which are rounded up [m]."""


def simplified(
    boxes: Float[Array, "target 11"], body: Int[Array, " target"]
) -> tuple[Float[Array, "kept 11"], Int[Array, " kept"]]:
    """Return surfaces with crowds simplified, and for each the index of the original surface that it represents.

    Args:
        boxes: Rows as in `drop_tables`: centre, axis, half sizes, diagonal, supporting half sizes, bottom, top.
        body: Body of each surface.
    """
    if len(boxes) <= MOST:
        return boxes, np.arange(len(boxes))
    bodies, counts = np.unique(body, return_counts=True)
    crowds = bodies[counts > MAX_BOXES].tolist()
    few = np.flatnonzero(~np.isin(body, crowds))
    rows, source = [boxes[few]], [few]
    for one in crowds:
        mine = np.flatnonzero(body == one)
        crowd = _from_above(boxes[mine], max(_LEAST, MOST // len(crowds)))
        rows.append(crowd)
        source.append(np.full(len(crowd), mine[0]))
    order = np.argsort(np.concatenate(source), kind="stable")
    return np.concatenate(rows)[order], np.concatenate(source)[order]


def _from_above(boxes: Float[Array, "target 11"], most: int) -> Float[Array, "kept 11"]:
    width, step = _WIDTH, _STEP
    while True:
        found = _map(boxes, width, step)
        if len(found) <= most:
            return found
        width, step = _COARSER * width, _COARSER * step


def _map(boxes: Float[Array, "target 11"], width: float, step: float) -> Float[Array, "kept 11"]:
    centre, axis, half, (bottom, top) = boxes[:, :2], np.abs(boxes[:, 2:4]), boxes[:, 4:6], boxes[:, 9:11].T
    reach = axis * half[:, :1] + axis[:, ::-1] * half[:, 1:]
    corner = (centre - reach).min(axis=0)
    cells = np.maximum(1, np.ceil(((centre + reach).max(axis=0) - corner) / width - 1e-9)).astype(int)
    highest, lowest = np.full(cells, -np.inf), np.full(cells, np.inf)
    # A box covers the cells whose centres it contains, or else the cell that contains its own centre.
    first = np.ceil((centre - reach - corner) / width - 0.5).astype(int)
    last = np.floor((centre + reach - corner) / width - 0.5).astype(int) + 1
    own = np.clip(((centre - corner) / width).astype(int), 0, cells - 1)
    narrow = last <= first
    first, last = np.where(narrow, own, first), np.where(narrow, own + 1, last)
    for k in np.argsort(top, kind="stable").tolist():
        part = slice(first[k, 0], last[k, 0]), slice(first[k, 1], last[k, 1])
        highest[part] = top[k]
        lowest[part] = np.minimum(lowest[part], bottom[k])
    x, y = np.nonzero(np.isfinite(highest))
    level = np.ceil(highest[x, y] / step - 1e-9).astype(np.int64)
    begin, end = joined(np.stack([x, y, 2 * level], axis=1))
    kept = np.zeros((len(begin), 11))
    lower, upper = corner + begin[:, :2] * width, corner + end[:, :2] * width
    kept[:, 0:2], kept[:, 2] = 0.5 * (lower + upper), 1.0
    kept[:, 4:6] = kept[:, 7:9] = 0.5 * (upper - lower)
    kept[:, 6] = kept[:, 4:6].sum(axis=1) / np.sqrt(2.0)
    parts = [(slice(a[0], b[0]), slice(a[1], b[1])) for a, b in zip(begin, end, strict=True)]
    kept[:, 9] = [lowest[part].min() for part in parts]
    kept[:, 10] = np.minimum(begin[:, 2] // 2 * step, [highest[part].max() for part in parts])
    return kept

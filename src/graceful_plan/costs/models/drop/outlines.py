"""Outlines in top view: the axes of all targets, and the reach of the object's parts along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.models.drop.functions import part_reach
from graceful_plan.costs.models.drop.release import Release, heights
from graceful_plan.costs.models.drop.tables import BALL, ROUND, DropTables


@final
class Targets:
    """Rotates vectors of W into the targets' axes in top view, and reduces values over the targets of each level."""

    def __init__(self, tables: DropTables) -> None:
        self.tables = tables
        self.top, self.axis, start = tables.target_height[:, 1], tables.target_axis, tables.level_start
        self.x = np.concatenate([self.axis, np.zeros((len(self.axis), 1))], axis=1)
        self.y = np.concatenate([-self.axis[:, 1:], self.axis[:, :1], np.zeros((len(self.axis), 1))], axis=1)
        self.first, self.level = start[:-1], np.repeat(np.arange(len(start) - 1), np.diff(start))

    def turn(self, vector: Array) -> tuple[Array, Array]:
        """Rotate vectors [n 2+] or [n target 2+] into the targets' axes."""
        vector = vector[:, None] if vector.ndim == 2 else vector
        c, s = self.axis[:, 0], self.axis[:, 1]
        return c * vector[..., 0] + s * vector[..., 1], c * vector[..., 1] - s * vector[..., 0]

    def place(self, point: Array) -> tuple[Array, Array]:
        """Express points [n 2+] or [n target 2+] relative to the targets' centres, in their axes."""
        point = point[:, None] if point.ndim == 2 else point
        return self.turn(point[..., :2] - self.tables.target_centre)

    def sum(self, value: Float[Array, "n target"]) -> Float[Array, "n level"]:
        """Sum over the targets of each level."""
        return np.add.reduceat(value, self.first, axis=1)

    def product(self, value: Float[Array, "n target"]) -> Float[Array, "n level"]:
        """Multiply over the targets of each level."""
        return np.multiply.reduceat(value, self.first, axis=1)

    def spread(self, value: Float[Array, "n level"]) -> Float[Array, "n target"]:
        """Broadcast the value of each level to its targets."""
        return value[:, self.level]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """Reach of the object's parts: per part [n part] or [n part target]."""

    bottom: Array
    x: Array
    y: Array
    diagonal: tuple[Array, Array]
    low: Array
    high: Array
    tilt: Array


def shape_of(targets: Targets, state: Release) -> Shape:
    """Compute the reach of the parts in each state."""
    tables, diagonals = targets.tables, ((targets.x + targets.y) / np.sqrt(2.0), (targets.y - targets.x) / np.sqrt(2.0))

    def reach(u: Array) -> Array:
        each = zip(tables.part_half, tables.part_kind, strict=True)
        return np.stack(
            [part_reach(state.axes[:, p], half, int(kind), u) for p, (half, kind) in enumerate(each)], axis=1
        )

    bottom, top = heights(state, tables)
    m = state.axes[:, tables.main, 2] ** 2
    kind = tables.part_kind[tables.main]
    if kind == ROUND:
        m = np.stack([m[:, 0] + m[:, 1], m[:, 2]], axis=1)
    tilt = np.zeros(len(m)) if kind == BALL else 1.0 - (m * m).sum(axis=1)
    return Shape(
        bottom=bottom,
        x=reach(targets.x),
        y=reach(targets.y),
        diagonal=(reach(diagonals[0]), reach(diagonals[1])),
        low=bottom.min(axis=1, keepdims=True),
        high=top.max(axis=1, keepdims=True),
        tilt=tilt[:, None],
    )

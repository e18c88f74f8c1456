"""Height maps as obstacles: columns up to the measured height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array, is_real, plain_numbers, real_array
from graceful_plan.scene.sensed.boxes import FARTHEST, add_boxes, check_width, joined


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class HeightMap:
    """Heights over a grid, as an obstacle to add to a scene with `Scene.edit`; all space below them is occupied.

    | field   | meaning                                                                | unit | shape   |
    |---------|------------------------------------------------------------------------|------|---------|
    | name    | of the new body                                                        |      |         |
    | heights | in W, the first index along x, the second one along y; NaN or -infinity where empty | m    | x y     |
    | cell    | width of a cell                                                        | m    |         |
    | corner  | x and y in W of the corner of the first cell                           | m    | 2       |
    | bottom  | height at which columns begin                                          | m    |         |
    | step    | heights are rounded up to multiples of this                            | m    |         |
    | entity  | entity class if it can be harmed; None for an obstacle only            |      |         |

    Raises:
        ShapeError: If the heights are not a two-dimensional array.
        SettingError: If a width is out of range, or a place or height is farther than 500 m from the origin.
    """

    name: str
    heights: ArrayLike
    cell: float
    corner: Sequence[float] | ArrayLike
    bottom: float = 0.0
    step: float = 0.01
    entity: str | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        heights = real_array(f"heights of {self.name}", self.heights)
        if heights.ndim != 2:
            raise ShapeError(f"heights of {self.name}", heights.shape, "(along x, along y)")
        for word in ("cell", "step"):
            check_width(f"{word} of {self.name}", getattr(self, word))
        if not is_real(self.bottom):
            raise SettingError(f"bottom of {self.name}", self.bottom, "a height [m]")
        corner = finite_array(f"corner of {self.name}", np.asarray(self.corner), ndim=1, last=2)
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "corner", corner)
        known = heights[~np.isnan(heights) & (heights != -np.inf)]
        farthest = np.abs(
            [self.bottom, *corner, *(corner + np.multiply(heights.shape, self.cell)), known.max(initial=0)]
        )
        # An infinite height would be dropped below, and the robot would drive through the obstacle.
        if not farthest.max() <= FARTHEST:
            raise SettingError(self.name, float(farthest.max()), f"heights and places within {FARTHEST:g} m of W")

    @property
    def boxes(self) -> tuple[Float[Array, "box 3"], Float[Array, "box 3"]]:
        """Lower and upper corners of the occupied boxes in W [m]."""
        heights, corner = np.asarray(self.heights), np.asarray(self.corner)
        above = np.isfinite(heights) & (heights > self.bottom)
        x, y = np.nonzero(above)
        if not len(x):
            return np.zeros((0, 3)), np.zeros((0, 3))
        steps = np.ceil((heights[above] - self.bottom) / self.step - 1e-9).astype(np.int64)
        # Columns of equal height are cells of one layer; doubled layer indices keep layers from being adjacent.
        first, last = joined(np.stack([x, y, 2 * steps], axis=1))
        lower = np.column_stack([corner + first[:, :2] * self.cell, np.full(len(first), self.bottom)])
        top = self.bottom + first[:, 2] // 2 * self.step
        return lower, np.column_stack([corner + last[:, :2] * self.cell, top])

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add a body with all columns.

        Raises:
            SceneError: If the name is taken.
            SettingError: If the step gives too many boxes.
        """
        add_boxes(spec, self.name, *self.boxes, "step")

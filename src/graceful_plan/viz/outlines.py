"""Outlines of entities from above, with the severity of a drop on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.models.mixture.mixture import FALLING
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.footprints import entity_outlines


def draw_entities(axes: Any, scene: Scene) -> None:
    """Draw the outline of every entity and the severity of the carried object and contents on it."""
    from matplotlib.patches import Polygon

    falling = [name for name in FALLING if name in scene.components]
    shapes = {name: _visible(parts) for name, parts in entity_outlines(scene, list(scene.entities)).items()}
    middles = {name: np.concatenate(parts).mean(axis=0) for name, parts in shapes.items() if parts}
    sizes = {name: float(np.prod(np.subtract(*_extent(shapes[name])))) for name in middles}
    for name, middle in middles.items():
        for polygon in shapes[name]:
            axes.add_patch(Polygon(polygon, closed=True, fill=False, edgecolor="#444444", linewidth=0.8))
        severity = sum(scene.entities[name].severity[component] for component in falling)
        low, high = _extent(shapes[name])
        others = [m for other, m in middles.items() if sizes[other] < sizes[name]]
        crowded = any(np.all((m > low) & (m < high)) for m in others)
        place = low + 0.012 if crowded else middle
        axes.text(
            *place, f"{severity:g}", ha="center", va="center", fontsize=7, color="#222222", clip_on=True, zorder=3.5
        )


def _extent(polygons: Sequence[Float[Array, "_ 2"]]) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
    points = np.concatenate(polygons)
    return points.min(axis=0), points.max(axis=0)


def _visible(polygons: Sequence[Float[Array, "_ 2"]]) -> list[Float[Array, "_ 2"]]:
    """Remove outlines within the extent of another one, such as the legs of a table."""
    extents = [_extent([polygon]) for polygon in polygons]
    return [
        polygon
        for i, polygon in enumerate(polygons)
        if not any(
            i != j
            and np.all(low <= extents[i][0])
            and np.all(extents[i][1] <= high)
            and not np.array_equal(polygon, polygons[j])
            for j, (low, high) in enumerate(extents)
        )
    ]

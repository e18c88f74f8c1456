"""Picture of an impact map: the impact as colours, with the outlines of entities from above."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Any

import numpy as np

from graceful_plan.analysis.impact_maps import ImpactMap
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.outlines import draw_entities
from graceful_plan.viz.style import STYLE, heat_map

_BLOCKED = "#b8bdc4"
_ARROW = 0.12  # length of the arrow of the direction, relative to the width of the map


def draw_impact_map(impact_map: ImpactMap, scene: Scene, file: str | FilePath) -> None:
    """Draw an impact map from above; numbers on entities are severities, grey cells are blocked for the object.

    Args:
        impact_map: Result of `graceful_plan.impact_map`.
        scene: Scene of the map.
        file: Picture to write; its extension selects the format (png, pdf, svg).
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    x, y, impact = impact_map.x, impact_map.y, impact_map.impact
    edges = _edges(x), _edges(y)
    width, height = (float(edge[-1] - edge[0]) for edge in edges)
    with rc_context(STYLE):
        scale = 6.0 / max(width, height)
        figure = Figure(figsize=(max(3.5, scale * width) + 1.4, max(2.0, scale * height) + 0.9), dpi=150)
        figure.set_layout_engine("constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        axes.set_facecolor(_BLOCKED)  # shows through where the map has no value
        highest = 1e-9 if impact_map.blocked.all() else max(float(np.nanmax(impact)), 1e-9)
        image = axes.imshow(
            np.ma.masked_invalid(impact),
            extent=(edges[0][0], edges[0][-1], edges[1][0], edges[1][-1]),
            origin="lower",
            cmap=heat_map(),
            vmin=0.0,
            vmax=highest,
            interpolation="nearest",
        )
        draw_entities(axes, scene)
        if impact_map.direction is not None and impact_map.speed > 0.0:
            _draw_arrow(axes, np.array([edge[0] for edge in edges]), width, impact_map.direction)
        axes.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]], aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axes.set_title(_title(impact_map))
        figure.colorbar(image, ax=axes, shrink=0.8, aspect=30, pad=0.02, label="expected impact of a release here")
        figure.savefig(file)


def _edges(centres: np.ndarray) -> np.ndarray:
    """Return the edges of cells from their centres; a single cell is 1 cm wide."""
    step = float(centres[1] - centres[0]) if len(centres) > 1 else 0.01
    return np.append(centres - 0.5 * step, centres[-1] + 0.5 * step)


def _draw_arrow(axes: Any, low: np.ndarray, width: float, direction: float) -> None:
    """Draw the direction of flight in the lower left corner, in metres so that the angle is correct."""
    middle = low + 1.2 * _ARROW * width
    half = 0.5 * _ARROW * width * np.array([np.cos(direction), np.sin(direction)])
    axes.annotate("", xy=middle + half, xytext=middle - half, arrowprops={"arrowstyle": "-|>", "color": "#0b62c4"})


def _title(impact_map: ImpactMap) -> str:
    speed, spread = f"{impact_map.speed:g} m/s", "" if impact_map.direction is not None else ", any direction"
    how = f"{speed}{spread}" if impact_map.speed else "at rest"
    lowest = impact_map.surface + impact_map.height
    title = f"{impact_map.carried} released {impact_map.height:g} m up (z = {lowest:.2f} m), {how}"
    return f"{title}\nnumbers: severity; grey: blocked"

"""Figures for papers and reports, drawn by matplotlib without a display."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import FALLING
from graceful_plan.costs.objective import Objective, SceneObjective, search_paces
from graceful_plan.path import Path
from graceful_plan.scene.scene import Scene
from graceful_plan.viz.drop import drop_impact
from graceful_plan.viz.footprints import object_positions, outline, surface_points
from graceful_plan.viz.outlines import draw_entities
from graceful_plan.viz.style import HALO, PATH_COLOURS, STYLE, heat_map

_LINE_STYLES = ((0, (5, 2)), "-", (0, (1, 1)), (0, (6, 2, 1, 2)))
_GRID = 0.005
_MARGIN = 0.14
_STEP = 0.02
_NARROWEST, _WIDEST = 1.2, 1.8
"""Limits of the aspect ratio (width over height) of the view from above."""


def compare_paths(scene: Scene, paths: Mapping[str, Path], file: str | FilePath, *, speed: float = 1.0) -> None:
    """Draw paths from above over the impact of a drop, and their impact and height along the path.

    Args:
        scene: Scene with an object in the gripper and at least one entity.
        paths: At most four paths by label, the first one dashed.
        file: Picture to write; its extension selects the format (png, pdf, svg).
        speed: Fraction of the velocity limits, as in `plan`.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    dense = {label: path.resampled(_STEP) for label, path in paths.items()}
    positions = {label: object_positions(scene, path) for label, path in dense.items()}
    falling = Objective(impact=ImpactCost(components=FALLING)).bind(scene, search_paces(speed))
    with rc_context(STYLE):
        figure = Figure(figsize=(10.0, 4.7), dpi=200, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.75, 1.0))
        above, impact, height = (figure.add_subplot(cell) for cell in (grid[:, 0], grid[0, 1], grid[1, 1]))
        image = _draw_from_above(above, scene, dense, positions)
        figure.colorbar(
            image,
            ax=above,
            location="bottom",
            shrink=0.6,
            aspect=40,
            pad=0.02,
            label="impact if the object falls here from rest",
        )
        _draw_along(impact, dense, {label: _impact_along(falling, x) for label, x in dense.items()})
        impact.set(title="Impact if it falls now, in motion", ylabel="impact", ylim=(0, None))
        impact.tick_params(labelbottom=False)
        _draw_along(height, dense, {label: p[:, 2] for label, p in positions.items()})
        height.set(title="Height of the object", xlabel="path length [rad]", ylabel="height [m]")
        height.sharex(impact)
        figure.savefig(file)


def _impact_along(falling: SceneObjective, path: Path) -> Float[Array, " n"]:
    """Return the impact at each vertex, averaged over the two speeds of the objective."""
    ahead = np.gradient(path.q, axis=0) if len(path) > 1 else np.zeros_like(path.q)
    limit = np.max(np.abs(ahead) / falling.scene.limits.velocity, axis=1, keepdims=True)
    fastest = ahead / np.where(limit > 0.0, limit, 1.0)
    return np.mean([falling.states(path.q, pace * fastest) for pace in falling.paces], axis=0)


def _draw_from_above(
    axes: Any, scene: Scene, paths: Mapping[str, Path], positions: Mapping[str, Float[Array, "n 3"]]
) -> Any:
    x, y = _window(positions)
    label = list(paths)[-1]
    reference = paths[label].q[np.argsort(positions[label][:, 2])[len(positions[label]) // 2]]
    heat = drop_impact(scene, reference, x, y)
    image = axes.imshow(
        heat,
        extent=(x[0] - _GRID / 2, x[-1] + _GRID / 2, y[0] - _GRID / 2, y[-1] + _GRID / 2),
        origin="lower",
        cmap=heat_map(),
        vmin=0.0,
        vmax=max(float(heat.max()), 1e-9),
        alpha=0.85,
        interpolation="bilinear",
    )
    draw_entities(axes, scene)
    for i, (label, position) in enumerate(positions.items()):
        _draw_path(axes, i, label, position)
        _draw_object(axes, scene, paths[label], i)
    ends = next(iter(positions.values()))[[0, -1]]
    for end, name in zip(ends, ("start", "goal"), strict=True):
        axes.annotate(
            name,
            end[:2],
            xytext=(0, 17),
            textcoords="offset points",
            ha="center",
            weight="bold",
            bbox=HALO,
            zorder=9,
        )
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title("Seen from above; numbers: severity")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=len(paths))
    return image


def _window(positions: Mapping[str, Float[Array, "n 3"]]) -> tuple[Float[Array, " nx"], Float[Array, " ny"]]:
    """Return the grid around the paths and their margin [m]."""
    points = np.concatenate(list(positions.values()))[:, :2]
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    wanted = np.array([_NARROWEST, 1.0 / _WIDEST]) * (high - low)[::-1]
    missing = np.maximum(0.0, wanted - (high - low))
    low, high = low - missing / 2, high + missing / 2
    return np.arange(low[0], high[0], _GRID), np.arange(low[1], high[1], _GRID)


def _draw_path(axes: Any, index: int, label: str, position: Float[Array, "n 3"]) -> None:
    colour, style = PATH_COLOURS[index], _LINE_STYLES[index]
    axes.plot(*position[:, :2].T, color="white", linewidth=4.5, zorder=4)
    axes.plot(*position[:, :2].T, color=colour, linestyle=style, linewidth=2.0, label=label, zorder=5 + index)


def _draw_object(axes: Any, scene: Scene, path: Path, index: int) -> None:
    """Draw outlines of the carried object at a few points of a path."""
    from matplotlib.patches import Polygon

    if scene.carried is None:
        return
    for i in np.linspace(0, len(path) - 1, 7).astype(int):
        data = scene.data_at(path.q[i])
        points = [surface_points(scene, data, geom) for geom in scene.components["carried"].geoms]
        corners = outline(np.concatenate(points))
        ends = i in (0, len(path) - 1)
        axes.add_patch(
            Polygon(corners, facecolor=PATH_COLOURS[index], alpha=0.35 if ends else 0.14, edgecolor="none", zorder=3)
        )


def _draw_along(axes: Any, paths: Mapping[str, Path], values: Mapping[str, Float[Array, " n"]]) -> None:
    for i, (label, path) in enumerate(paths.items()):
        length = np.concatenate([[0.0], np.cumsum(path.segment_lengths)])
        axes.plot(length, values[label], color=PATH_COLOURS[i], linestyle=_LINE_STYLES[i], linewidth=1.8, label=label)
    axes.margins(x=0.01)

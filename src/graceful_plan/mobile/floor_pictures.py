"""Pictures of a floor from above: obstacles, entities, the impact of a failing base, and a motion with clearances."""

from __future__ import annotations

import math
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import checked_state, moving_batch
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.coast.moving_entities import planar_shapes
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.viz.footprints import entity_outlines
from graceful_plan.viz.style import HALO, PATH_COLOURS, STYLE, heat_map

_LAYER, _DIRECTIONS, _CRUISE = 0.2, 8, 0.6
"""Cell width of the risk layer [m], number of driving directions it averages over, and share of the greatest speed."""
_MOST_CELLS = 6_000
_RIM = 9
"""Number of points along each edge of a part of the base, from which clearances are drawn."""
_SHADES = 12
"""Number of times at which the base and moving entities are drawn."""
_WALKED = "#7a3fa0"


def draw_floor(
    scene: Scene,
    trajectory: Trajectory | None,
    file: str | FilePath,
    *,
    floor: OccupancyGrid | None = None,
    objective: Objective | None = None,
) -> None:
    """Draw a floor, its risk, and the clearances of a motion to all entities.

    The layer is the impact of a base that fails at 0.6 of its greatest speed, averaged over driving directions. Moving
    entities are taken at the time when the motion is nearest to the cell. A line shows the least clearance to each
    entity.

    Args:
        scene: Scene with a base.
        trajectory: Motion to draw; None draws the floor alone.
        file: Output file; its suffix selects the format (png, pdf, svg).
        floor: Map of the obstacles; default: cut from the scene.
        objective: Objective whose impact is shown; default: `Objective()`.

    Raises:
        SettingError: If the robot has no base.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if scene.base is None:
        raise SettingError("scene", scene.name, "one with a base that drives")
    floor = OccupancyGrid.from_scene(scene) if floor is None else floor
    corners = floor.in_world(np.array([[0, 0], [floor.size[0], 0], [0, floor.size[1]], floor.size]))
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    with rc_context(STYLE):
        scale = 9.0 / max(x1 - x0, 1.5 * (y1 - y0))
        figure = Figure(
            figsize=(scale * (x1 - x0) + 1.6, max(2.2, scale * (y1 - y0)) + 1.1), dpi=150, layout="constrained"
        )
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        image = _draw_layer(axes, scene, trajectory, (x0, x1, y0, y1), objective or Objective())
        _draw_walls(axes, floor)
        _draw_standing(axes, scene)
        if trajectory is not None:
            _draw_motion(axes, scene, trajectory)
            _draw_offsets(axes, scene, trajectory)
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x [m]", ylabel="y [m]")
        told = "" if trajectory is None else f", {trajectory.duration:.1f} s; lines: least clearance"
        axes.set_title(f"{scene.name}{told}")
        figure.colorbar(image, ax=axes, shrink=0.8, aspect=30, pad=0.02, label="impact if the base fails here")
        figure.savefig(file)


def _draw_layer(
    axes: Any,
    scene: Scene,
    trajectory: Trajectory | None,
    extent: tuple[float, float, float, float],
    objective: Objective,
) -> Any:
    x0, x1, y0, y1 = extent
    cell = max(_LAYER, math.sqrt((x1 - x0) * (y1 - y0) / _MOST_CELLS))
    x, y = np.arange(x0 + 0.5 * cell, x1, cell), np.arange(y0 + 0.5 * cell, y1, cell)
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    base = scene.base
    assert base is not None
    rest = np.clip(np.zeros(len(scene.joints)), *scene.limits.position.T) if trajectory is None else trajectory.q[0]
    q, qd, value = np.tile(rest, (len(at), 1)), np.zeros((len(at), len(rest))), np.zeros(len(at))
    q[:, :2] = at
    times = _times_near(scene, trajectory, at)
    for yaw in 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        q[:, 2], qd[:, :2] = yaw, _CRUISE * base.v_max * np.array([np.cos(yaw), np.sin(yaw)])
        value += checked_state(objective.impact, moving_batch(scene, q, qd, times)) / _DIRECTIONS
    return axes.imshow(
        value.reshape(len(y), len(x)),
        extent=(x[0] - 0.5 * cell, x[-1] + 0.5 * cell, y[0] - 0.5 * cell, y[-1] + 0.5 * cell),
        origin="lower",
        cmap=heat_map(),
        vmin=0.0,
        vmax=max(float(value.max()), 1e-9),
        interpolation="bilinear",
    )


def _times_near(
    scene: Scene, trajectory: Trajectory | None, at: Float[Array, "cell 2"]
) -> Float[Array, " cell"] | None:
    """Return the time at which the motion is nearest to each cell [s]; None if the scene has no moving entity."""
    if not scene.moving:
        return None
    if trajectory is None:
        return np.zeros(len(at))
    t = np.linspace(trajectory.t[0], trajectory.t[-1], 100)
    way = trajectory.positions(t)[:, :2]
    return t[np.argmin(np.linalg.norm(at[:, None] - way, axis=-1), axis=1)]


def _draw_walls(axes: Any, floor: OccupancyGrid) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.transforms import Affine2D

    x, y, yaw = floor.origin
    turned = Affine2D().rotate(yaw).translate(x, y) + axes.transData
    axes.imshow(
        np.ma.masked_equal(floor.occupied.astype(float), 0.0),
        extent=(0.0, floor.size[0], 0.0, floor.size[1]),
        origin="lower",
        cmap=ListedColormap(["#3c434d"]),
        interpolation="nearest",
        transform=turned,
        zorder=2,
    )


def _draw_standing(axes: Any, scene: Scene) -> None:
    from matplotlib.patches import Polygon

    for name, parts in entity_outlines(scene, list(scene.entities)).items():
        for corners in parts:
            axes.add_patch(Polygon(corners, closed=True, facecolor="#f4c542", edgecolor="#333333", zorder=3))
        middle = np.concatenate(parts).mean(axis=0)
        _name(axes, name, middle)


def _draw_motion(axes: Any, scene: Scene, trajectory: Trajectory) -> None:
    from matplotlib.patches import Circle, Polygon

    way = trajectory.positions(np.linspace(trajectory.t[0], trajectory.t[-1], 400))
    axes.plot(way[:, 0], way[:, 1], color="white", linewidth=4.0, zorder=4)
    axes.plot(way[:, 0], way[:, 1], color=PATH_COLOURS[1], linewidth=2.0, zorder=5)
    times = np.linspace(trajectory.t[0], trajectory.t[-1], _SHADES)
    disc = _rim(scene)
    low, high = (disc[:, :2] - disc[:, 2:]).min(axis=0), (disc[:, :2] + disc[:, 2:]).max(axis=0)
    box = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    for q in trajectory.positions(times):
        c, s = np.cos(q[2]), np.sin(q[2])
        axes.add_patch(
            Polygon(
                q[:2] + box @ np.array([[c, s], [-s, c]]), fill=False, edgecolor=PATH_COLOURS[1], alpha=0.5, zorder=4
            )
        )
    for name, entity in scene.moving.items():
        shape, _, _ = planar_shapes(entity, times)
        walked = entity.at(np.linspace(times[0], times[-1], 100)).position
        axes.plot(walked[:, 0], walked[:, 1], color=_WALKED, linestyle=":", linewidth=1.5, zorder=4)
        radius = float(entity.size[0]) if entity.is_round else float(np.linalg.norm(entity.size[:2]))
        for k, row in enumerate(shape):
            shade = 0.15 + 0.6 * k / _SHADES
            axes.add_patch(Circle(row[:2], radius, facecolor=_WALKED, edgecolor="none", alpha=0.3 * shade, zorder=3))
        _name(axes, name, shape[0, :2])
    for q, word in ((trajectory.q[0], "start"), (trajectory.q[-1], "goal")):
        axes.annotate(
            word, q[:2], xytext=(0, 14), textcoords="offset points", ha="center", weight="bold", bbox=HALO, zorder=9
        )


def _rim(scene: Scene) -> Float[Array, "disc 3"]:
    """Return discs along the edges of the base, in its frame: centre and radius [m]."""
    edge = np.linspace(-1.0, 1.0, _RIM)
    ones = np.ones(_RIM)
    square = np.concatenate(
        [np.stack(side, axis=-1) for side in ((edge, ones), (edge, -ones), (ones, edge), (-ones, edge))]
    )
    discs = []
    for x, y, ux, uy, a, b, radius in coast_tables(scene).outline:
        at = np.array([x, y]) + square * (a, b) @ np.array([[ux, uy], [-uy, ux]])
        discs.append(np.column_stack([at, np.full(len(at), radius)]))
    return np.concatenate(discs)


def _draw_offsets(axes: Any, scene: Scene, trajectory: Trajectory) -> None:
    """Draw the least clearance of the base to each entity."""
    t = np.linspace(trajectory.t[0], trajectory.t[-1], 400)
    q, disc = trajectory.positions(t), _rim(scene)
    c, s = np.cos(q[:, 2, None]), np.sin(q[:, 2, None])
    centre = np.stack([c * disc[:, 0] - s * disc[:, 1], s * disc[:, 0] + c * disc[:, 1]], axis=-1) + q[:, None, :2]
    bodies = {name: np.concatenate(parts) for name, parts in entity_outlines(scene, list(scene.entities)).items()}
    for points in bodies.values():
        gap = np.linalg.norm(centre[:, :, None] - points, axis=-1) - disc[:, 2, None]
        k, d, p = np.unravel_index(int(np.argmin(gap)), gap.shape)
        _offset(axes, (centre[k, d], float(disc[d, 2])), points[p], float(gap.min()))
    for entity in scene.moving.values():
        place = entity.at(t).position[:, None, :2]
        radius = float(entity.size[0]) if entity.is_round else float(np.linalg.norm(entity.size[:2]))
        gap = np.linalg.norm(centre - place, axis=-1) - disc[:, 2] - radius
        k, d = np.unravel_index(int(np.argmin(gap)), gap.shape)
        way = centre[k, d] - place[k, 0]
        edge = place[k, 0] + radius * way / max(float(np.linalg.norm(way)), 1e-9)
        _offset(axes, (centre[k, d], float(disc[d, 2])), edge, float(gap.min()))


def _offset(axes: Any, disc: tuple[Float[Array, " 2"], float], to: Float[Array, " 2"], gap: float) -> None:
    centre, radius = disc
    way = to - centre
    edge = centre + radius * way / max(float(np.linalg.norm(way)), 1e-9)
    axes.plot(*np.stack([edge, to]).T, color="#111111", linewidth=1.2, zorder=7)
    axes.annotate(
        f"{max(gap, 0.0):.2f} m", 0.5 * (edge + to), xytext=(5, 0), textcoords="offset points", fontsize=7.5, bbox=HALO,
        zorder=8,
    )  # fmt: skip


def _name(axes: Any, name: str, at: Float[Array, " 2"], *, above: bool = False) -> None:
    axes.annotate(
        name,
        at,
        xytext=(0, 14 if above else -20),
        textcoords="offset points",
        ha="center",
        fontsize=8,
        weight="bold" if above else "normal",
        bbox=HALO,
        zorder=8,
    )

"""HTML page with the motions of a Pareto front: one file, without network or server."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import FALLING
from graceful_plan.costs.objective import DEFAULT_WEIGHT, Objective
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.harm.severity import SCALE
from graceful_plan.scene.scene import Scene
from graceful_plan.tuning.pareto_front import Choice, ParetoFront
from graceful_plan.tuning.points import ParetoPoint
from graceful_plan.viz.footprints import object_positions, outline, surface_points

_TEMPLATE = FilePath(__file__).with_name("front_page.html")
_SAMPLES = 60
"""Number of drawn samples of each motion."""
_PEOPLE = ("adult", "adult_head", "child")
"""Classes of entities that are people."""
_OBJECTS = 5
"""Number of samples at which the carried object is outlined."""
_VIEWS: Mapping[str, tuple[int, int, int]] = {"top": (0, 1, 2), "side": (0, 2, 1)}
"""Axes of W for each view: to the right, upwards, and the viewing direction."""


def write_front_page(
    front: ParetoFront,
    scene: Scene,
    file: str | FilePath,
    choice: Choice | None = None,
    observed: Sequence[Mapping[str, Any]] = (),
    title: str = "",
    space: Mapping[str, str] | None = None,
) -> None:
    """Write the page.

    Args:
        front: With at least one point.
        scene: Scene with the carried object attached.
        file: HTML file to write.
        choice: Chosen point to mark.
        observed: FailBench's result for each point: predicted and observed impact of a failure, the latter with an
            interval (`predicted`, `observed`, `low`, `high`); if known, the difference to the shortest motion with its
            interval (`difference`) and the number of `failures`. Or why the simulated robot could not execute it
            (`refused`).
        title: Title of the page; the name of the scene by default.
        space: 3-D view of a motion: its name (`of`), the HTML document (`page`), and the reason for an empty one
            (`why`).

    Raises:
        SettingError: If the front is empty, or the number of observations differs from that of points.
    """
    if not len(front):
        raise SettingError("front", front.status.name, "a front with at least one point")
    if observed and len(observed) != len(front):
        raise SettingError("observed", len(observed), f"one observation for each of {len(front)} points")
    data = {
        "title": title or front.scene or scene.notes.name,
        "points": [_point(point, scene) for point in front.points],
        "entities": _entities(scene),
        "knee": _index(front, front.knee),
        "chosen": None if choice is None else _index(front, choice.point),
        "choice": None if choice is None else {"status": choice.status.value, "w": choice.w, "detail": choice.detail},
        "observed": list(observed),
        "hypervolume": front.hypervolume(),
        "space": None if space is None else dict(space),
        "scale": [[value, words] for value, words in SCALE.items()],
        "default_w": DEFAULT_WEIGHT,
    }
    # A name must not end the script element that contains it.
    text = json.dumps(_plain(data), allow_nan=False).replace("<", "\\u003c")
    page = _TEMPLATE.read_text(encoding="utf-8")
    FilePath(file).write_text(page.replace("/*DATA*/null", text), encoding="utf-8")


def _index(front: ParetoFront, point: ParetoPoint | None) -> int | None:
    return next((i for i, other in enumerate(front.points) if other is point), None)


def _point(point: ParetoPoint, scene: Scene) -> dict[str, Any]:
    duration = point.trajectory.duration
    path = point.trajectory.sample(duration / _SAMPLES).path if duration > 0.0 else point.path
    places = np.linspace(0, len(path) - 1, min(_OBJECTS, len(path))).astype(int)
    shapes = [_carried(scene, path.q[i]) for i in places]
    return {
        "motion": point.motion,
        "impact": point.impact,
        "weights": None if point.weights is None else list(point.weights),
        "made_by": point.made_by,
        "made_with": point.made_with,
        "duration": duration,
        "by_entity": dict(point.cost.impact_by_entity),
        "chances": _chances(point, scene),
        "tool": object_positions(scene, path).round(4).tolist(),
        "objects": {view: [shape[view] for shape in shapes if view in shape] for view in _VIEWS},
    }


def _chances(point: ParetoPoint, scene: Scene) -> dict[str, float]:
    """Return the probability that a failure at a random moment hits, or reaches with contents, each person at all.

    It is that of the default impact model, and an upper bound: probabilities of components are added.
    """
    people = [name for name, entity in scene.entities.items() if entity.category in _PEOPLE]
    if not people or point.trajectory.duration == 0.0:
        return {}
    impact = ImpactCost()
    samples = Objective(impact=impact).bind(scene).cost_samples(point.trajectory)
    exposed = np.tensordot(samples.weight, impact.probability(samples.batch), axes=1) / samples.weight.sum()
    harmed = impact.harmed_entities(scene)
    return {name: float(min(1.0, exposed[:, harmed.index(name)].sum())) for name in people}


def _carried(scene: Scene, q: Float[Array, " nq"]) -> dict[str, list[list[float]]]:
    """Return the outlines of the carried object by view."""
    if scene.carried is None:
        return {}
    data = scene.data_at(q)
    points = np.concatenate([surface_points(scene, data, geom) for geom in scene.components["carried"].geoms])
    return {view: _outline(points, view) for view in _VIEWS} if len(points) else {}


def _entities(scene: Scene) -> list[dict[str, Any]]:
    data = scene.data_at(np.zeros(len(scene.joints)))
    falling = [name for name in FALLING if name in scene.components]
    found = []
    for name, entity in scene.entities.items():
        parts = [surface_points(scene, data, geom) for geom in entity.geoms]
        parts = [points for points in parts if len(points)]
        found.append(
            {
                "name": name,
                "category": entity.category,
                "severity": sum(entity.severity[component] for component in falling),
                **{view: [_outline(points, view) for points in parts] for view in _VIEWS},
            }
        )
    if scene.carried is not None:  # drawn along the path
        itself = {"name": scene.carried.body, "category": "carried", "severity": scene.own_severity}
        found.append({**itself, **{view: [] for view in _VIEWS}})
    return found


def _outline(points: Float[Array, "point 3"], view: str) -> list[list[float]]:
    return outline(points[:, list(_VIEWS[view])]).round(4).tolist()


def _plain(value: Any) -> Any:
    """Replace non-finite numbers by None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value

"""Native kernels of moving entities for searches, which treat each as standing at a few places of its predicted path.

A search knows no times. For each place there is a drop model in which the entity stands there among the static targets,
with the uncertainty of its position added to that of the release. The mean over places approximates the path. It equals
the mean of `drops.py` up to motion during the fall and the blurring of static targets: a few percent. It only guides
the search; reported costs are those of `drops.py`.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, DropKernel
from graceful_plan.costs.models.drop.tables import DISC, DropTables, drop_tables, levels
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

MOST_PLACES = 16
"""Largest number of places for a predicted path."""
_SPACING = 0.1, 0.25  # least and greatest distance between places [m]
_ASKED = 512  # sampled states that decide whether an entity can be hit at a place
_NEGLIGIBLE = 1e-4  # probability below which a place is ignored


def moving_kernels(
    scene: Scene, settings: DropSettings, severity: Float[Array, " moving"], paces: tuple[float, float]
) -> list[ImpactKernel]:
    """Return the impact of drops on moving entities, for planners: kernels to add up.

    Args:
        scene: The scene; if nothing is carried, there are no kernels.
        settings: Constants of the drop model.
        severity: Severity of each moving entity, summed over falling components.
        paces: See `NativeModel.kernel`.
    """
    if scene.carried is None:
        return []
    constants = settings.of(drop_tables(scene).shape_class)
    return [
        model.with_severity(_of_object(share * weight), paces)
        for entity, weight in zip(scene.moving.values(), severity.tolist(), strict=True)
        if weight > 0.0
        for model, share in _standing(scene, entity.name, constants)
    ]


def _of_object(severity: float) -> Float[Array, "row 1"]:
    """Return the severities of one entity, in the row of the object, which represents all falling components."""
    rows = np.zeros((len(ROWS), 1))
    rows[ROWS.index("carried")] = severity
    return rows


@per_scene
def _standing(scene: Scene, entity: str, constants: DropConstants) -> list[tuple[DropKernel, float]]:
    """Return a drop model for each place where the entity can be hit, with its share of the time."""
    places = _places(scene.moving[entity])
    models = [_model(scene, constants, place, spread) for place, spread in places]
    return [(model, 1.0 / len(places)) for model in models if _matters(scene, model)]


def _places(entity: MovingEntity) -> list[tuple[MovingEntity, float]]:
    """Return the entity at rest in the middles of equal time intervals, and the position uncertainty of each [m]."""
    duration = float(entity.t[-1] - entity.t[0])
    length = float(np.linalg.norm(np.diff(entity.position, axis=0), axis=1).sum())
    spacing = float(np.clip(2.0 * entity.half_size[:2].min(), *_SPACING))
    count = int(np.clip(np.ceil(length / spacing), 1, MOST_PLACES))
    edges = entity.at(entity.t[0] + duration * np.arange(count + 1) / count)
    middle = entity.at(entity.t[0] + duration * (np.arange(count) + 0.5) / count)
    step = np.linalg.norm(np.diff(edges.position[:, :2], axis=0), axis=1)
    spread = np.sqrt(middle.spread**2 + step**2 / 12.0)  # uniform distribution over the interval
    still = [
        MovingEntity(entity.name, entity.category, size=entity.size, t=np.zeros(1), position=p[None], yaw=yaw[None])
        for p, yaw in zip(middle.position, middle.yaw, strict=True)
    ]
    return list(zip(still, spread.tolist(), strict=True))


def _model(scene: Scene, constants: DropConstants, entity: MovingEntity, spread: float) -> DropKernel:
    blurred = replace(constants, position_spread=float(np.hypot(constants.position_spread, spread)))
    tables = _with_target(drop_tables(scene), entity)
    return DropKernel(tables, blurred, compile_scene(scene).kernels, scene.limits.velocity, 1)


def _matters(scene: Scene, model: DropKernel) -> bool:
    rng = np.random.default_rng(0)
    lower, upper = scene.limits.position.T
    q = rng.uniform(np.maximum(lower, -np.pi), np.minimum(upper, np.pi), size=(_ASKED, len(lower)))
    qd = scene.limits.velocity * rng.uniform(-1.0, 1.0, size=q.shape)
    return bool(model.probability(q, qd).max() > _NEGLIGIBLE)


def _with_target(tables: DropTables, entity: MovingEntity) -> DropTables:
    """Return tables with the entity as an additional target, the only one that can be harmed."""
    where, (a, b, h) = entity.at(entity.t[0]), entity.half_size
    yaw = 0.0 if entity.is_round else float(where.yaw)
    row: dict[str, Any] = {
        "target_entity": 0,
        "target_centre": where.position[:2],
        "target_axis": [np.cos(yaw), np.sin(yaw)],
        "target_half": [a, b],
        "target_diagonal": a if entity.is_round else (a + b) / np.sqrt(2.0),
        "target_carries": [DISC * a, DISC * a] if entity.is_round else [a, b],
        "target_height": [where.position[2] - h, where.position[2] + h],
        "target_fixed": 0.0,
    }
    others = {name: getattr(tables, name) for name in row} | {"target_entity": np.full(len(tables.target_entity), -1)}
    found: dict[str, Any] = {name: np.concatenate([others[name], np.array([value])]) for name, value in row.items()}
    order = np.argsort(-found["target_height"][:, 1], kind="stable")
    found = {name: value[order] for name, value in found.items()}
    kept: dict[str, Any] = {field.name: getattr(tables, field.name) for field in fields(tables)}
    kept |= found
    kept["level_start"] = levels(found["target_height"][:, 1])
    return DropTables(**kept)

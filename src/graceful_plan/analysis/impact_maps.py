"""Maps of the impact of a drop over the workspace: the expected harm if the carried object is let go at each place.

The robot is left out, both as an obstacle and as a falling component: the object is placed everywhere at one height and
in one orientation (`gantry_scene`), and the interaction model predicts which entities it hits. Moving entities are left
out, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan import documents
from graceful_plan.analysis.checks import clearance
from graceful_plan.analysis.gantry import gantry_scene
from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.interaction import InteractionModel
from graceful_plan.costs.models.drop.release import heights, release
from graceful_plan.costs.models.drop.tables import DropTables, drop_tables
from graceful_plan.costs.models.mixture.mixture import FALLING
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.judge.exact import Judge
from graceful_plan.judge.motion_samples import reach
from graceful_plan.path import finite_array, is_real
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive

DIRECTIONS = 8
"""Number of directions of motion over which a map is averaged if no direction is given."""
_MOST = 1000.0
"""Largest height [m] and speed [m/s] that the kernels accept."""
MAX_CELLS = 1_000_000
_MARGIN = 0.2  # around entities [m]
_FAR_BELOW = 0.3  # entities farther below the surface do not widen the map [m]
_OVERLAP = 0.001  # penetration of the object from which a cell is blocked [m]
_STANDS = 0.01  # largest distance from a bottom to the top that it stands on [m]
_CHUNK = 20_000  # states per batch


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ImpactMap:
    """Expected impact of letting the carried object go, over positions of its centre of mass in the xy plane.

    | field     | meaning                                                                     | unit | shape         |
    |-----------|-----------------------------------------------------------------------------|------|---------------|
    | x         | centres of the cells                                                        | m    | nx            |
    | y         | centres of the cells                                                        | m    | ny            |
    | impact    | sum of P S given that the object is let go; NaN where the cell is blocked   |      | ny nx         |
    | by_entity | impact by entity                                                            |      | ny nx entity  |
    | entities  | names of the entities, and of the object itself if its own loss counts      |      | entity        |
    | carried   | name of the object                                                          |      |               |
    | surface   | height in W from which `height` is measured                                 | m    |               |
    | height    | of the object's lowest point above the surface                              | m    |               |
    | speed     | horizontal speed of the object                                              | m/s  |               |
    | direction | of motion, from x towards y; None: the mean over `DIRECTIONS` even ones     | rad  |               |
    | rotation  | R_WO, orientation of the object                                             |      | 3 3           |
    """

    x: Float[Array, " nx"]
    y: Float[Array, " ny"]
    impact: Float[Array, "ny nx"]
    by_entity: Float[Array, "ny nx entity"]
    entities: tuple[str, ...]
    carried: str
    surface: float
    height: float
    speed: float
    direction: float | None
    rotation: Float[Array, "3 3"]

    @property
    def blocked(self) -> Bool[Array, "ny nx"]:
        """Cells in which the object would penetrate something."""
        return np.isnan(self.impact)

    def to_document(self) -> dict[str, Any]:
        """Return everything as a document of plain numbers, lists and mappings."""
        by_entity = {name: self.by_entity[..., k].tolist() for k, name in enumerate(self.entities)}
        return {
            "schema": "graceful_plan.impact_map",
            "version": 1,
            "carried": self.carried,
            "surface": self.surface,
            "height": self.height,
            "speed": self.speed,
            "direction": self.direction,
            "rotation": self.rotation.tolist(),
            "x": self.x.tolist(),
            "y": self.y.tolist(),
            "impact": self.impact.tolist(),
            "by_entity": by_entity,
        }

    def to_json(self) -> str:
        """Return `to_document()` as JSON text; blocked cells are null."""
        return documents.to_json(self.to_document())

    def __str__(self) -> str:
        """Describe the worst place, in total and for each entity that can be harmed."""
        how = f"at {self.speed:g} m/s" if self.speed else "at rest"
        size = f"{len(self.x)} x {len(self.y)} cells, {self.blocked.sum()} of them blocked"
        title = f"{self.carried} let go {how}, {self.height:g} m above z = {self.surface:.3f} m: {size}"
        if self.blocked.all():
            return title
        rows = [self._worst("everything", self.impact)]
        parts = [self._worst(name, self.by_entity[..., k]) for k, name in enumerate(self.entities)]
        rows += sorted((row for row in parts if row[1] > 0.0), key=lambda row: -row[1])
        return f"{title}\n\n{documents.table(['', 'worst impact', 'at x [m]', 'at y [m]'], rows)}"

    def _worst(self, name: str, impact: Float[Array, "ny nx"]) -> list[Any]:
        row, column = np.unravel_index(int(np.nanargmax(impact)), impact.shape)
        return [name, float(impact[row, column]), round(float(self.x[column]), 3), round(float(self.y[row]), 3)]


def impact_map(
    scene: Scene,
    impact: Cost | None = None,
    *,
    height: float,
    speed: float = 0.0,
    direction: float | None = None,
    q: ArrayLike | None = None,
    surface: float | None = None,
    bounds: Sequence[float] | None = None,
    resolution: float = 0.02,
) -> ImpactMap:
    """Compute the expected impact of letting the carried object go, over a grid of positions.

    Args:
        scene: A scene with an object in the gripper.
        impact: The impact cost with its interaction model; the drop model by default. Components that do not fall
            contribute nothing.
        height: Height of the object's lowest point above the surface in all cells [m].
        speed: Horizontal speed of the object [m/s]; it does not rotate.
        direction: Direction of that speed [rad], from x towards y; the mean over `DIRECTIONS` directions if None.
        q: Configuration that defines the object's orientation; if None, that of its body in the model.
        surface: Height in W [m] from which `height` is measured; if None, the top on which most things stand.
        bounds: Least x, greatest x, least y and greatest y of the map [m]. If None, the map covers all entities that
            are not far below the surface, within the reach of the arm.
        resolution: Approximate width of a cell [m].

    Raises:
        ShapeError: If nothing is carried, or q or bounds have another shape.
        SettingError: If a setting is out of range, or the impact is not an `ImpactCost`.
    """
    if scene.carried is None:
        raise ShapeError("scene.carried", (), "a scene with a carried object; see Scene.attach")
    impact = ImpactCost(model="mixture") if impact is None else impact
    if not isinstance(impact, ImpactCost):
        raise SettingError("impact", impact, "an ImpactCost: other costs do not resolve entities")
    for name, value in (("height", height), ("speed", speed)):
        if not (is_real(value) and 0.0 <= value <= _MOST):
            raise SettingError(name, value, f"a finite number of at least 0 and at most {_MOST:g}")
    for name, value, unit in (("direction", direction, "an angle [rad]"), ("surface", surface, "a height in W [m]")):
        if value is not None and not (is_real(value) and np.isfinite(value)):
            raise SettingError(name, value, f"{unit}, finite, or None")
    rotation = _rotation(scene, q)
    gantry = gantry_scene(scene, rotation)
    tables = drop_tables(gantry)
    base = _surface(tables) if surface is None else float(surface)
    x, y = _cells(_bounds(scene, tables, base) if bounds is None else bounds, resolution)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    places = np.column_stack([grid, np.full(len(grid), base + height - _lowest(gantry))])
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS if direction is None else np.array([direction])
    free = ~_blocked(gantry, places)
    harmed = (*gantry.entities, *([scene.carried.body] if impact.counts_own_loss(gantry) else []))
    by_entity = np.full((len(places), len(harmed)), np.nan)
    by_entity[free] = _mean_impact(gantry, impact, places[free], float(speed), angles if speed else angles[:1])
    by_entity = by_entity.reshape(len(y), len(x), len(harmed))
    return ImpactMap(
        x=x,
        y=y,
        impact=np.where(free.reshape(len(y), len(x)), by_entity.sum(axis=-1), np.nan),
        by_entity=by_entity,
        entities=harmed,
        carried=scene.carried.body,
        surface=base,
        height=float(height),
        speed=float(speed),
        direction=None if direction is None else float(direction),
        rotation=rotation,
    )


# --- where ------------------------------------------------------------------------------------------------------------


def _rotation(scene: Scene, q: ArrayLike | None) -> Float[Array, "3 3"]:
    """R_WO at a configuration, or that of the body in the model."""
    assert scene.carried is not None  # checked by the caller
    body = scene.model.body(scene.carried.body).id
    if q is not None:
        return scene.data_at(q).xmat[body].reshape(3, 3).copy()
    w, x, y, z = scene.model.body_quat[body]
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _lowest(gantry: Scene) -> float:
    """Height of the object's lowest point above its centre of mass [m], negative."""
    tables = drop_tables(gantry)
    state = release(StateBatch(gantry, np.zeros((1, 3))), tables)
    return float(heights(state, tables)[0].min() - state.c[0, 2])


def _surface(tables: DropTables) -> float:
    """Return the height of the top on which most surfaces stand; of two with as many, the higher one.

    Raises:
        SettingError: If nothing stands on anything.
    """
    bottom, top = tables.target_height.T
    low, high = tables.target_centre - _extent(tables), tables.target_centre + _extent(tables)
    best, count = 0.0, 0
    for k in range(len(top)):  # highest first
        over = np.all((tables.target_centre >= low[k]) & (tables.target_centre <= high[k]), axis=1)
        stands = int(np.sum(over & (np.abs(bottom - top[k]) < _STANDS) & (top > top[k])))
        if stands > count:
            best, count = float(top[k]), stands
    if not count:
        raise SettingError("surface", None, "a height in W [m]: nothing in the scene stands on anything")
    return best


def _extent(tables: DropTables) -> Float[Array, "target 2"]:
    """Half sizes of the surfaces along x and y of W."""
    (c, s), (a, b) = np.abs(tables.target_axis.T), tables.target_half.T
    return np.stack([c * a + s * b, s * a + c * b], axis=1)


def _bounds(scene: Scene, tables: DropTables, surface: float) -> tuple[float, float, float, float]:
    mine = (tables.target_entity >= 0) & (tables.target_height[:, 1] > surface - _FAR_BELOW)
    if not mine.any():
        raise SettingError("bounds", None, "least and greatest x, least and greatest y [m]: no entities are so high")
    extent = _extent(tables)[mine] + _MARGIN
    low, high = (tables.target_centre[mine] - extent).min(axis=0), (tables.target_centre[mine] + extent).max(axis=0)
    if not compile_scene(scene).robot.slide.any():  # the reach of slides does not bound x and y
        model = scene.model
        base = scene.data_at(model.qpos0[scene.qpos_adr]).xanchor[model.joint(scene.joints[0]).id, :2]
        low, high = np.maximum(low, base - reach(scene)[0]), np.minimum(high, base + reach(scene)[0])
    if not np.all(low < high):
        raise SettingError("bounds", None, "least and greatest x, least and greatest y [m]: no entity is within reach")
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _cells(bounds: Sequence[float], resolution: float) -> tuple[Float[Array, " nx"], Float[Array, " ny"]]:
    box = finite_array("bounds", np.array(bounds), ndim=1, last=4).reshape(2, 2)
    positive("resolution", resolution, "a finite width of cells above 0 [m]")
    if not np.all(box[:, 0] < box[:, 1]):
        raise SettingError("bounds", bounds, "least x, greatest x, least y, greatest y [m]")
    counts = np.maximum(1.0, np.round((box[:, 1] - box[:, 0]) / resolution))
    if counts.prod() > MAX_CELLS:
        raise SettingError("resolution", resolution, f"wider cells: these are {counts.prod():.3g}, at most {MAX_CELLS}")
    x, y = (low + (np.arange(int(n)) + 0.5) * (high - low) / n for (low, high), n in zip(box, counts, strict=True))
    return x, y


def _blocked(gantry: Scene, places: Float[Array, "cell 3"]) -> Bool[Array, " cell"]:
    """Tell at which positions the object penetrates something; MuJoCo decides where the fast checker cannot."""
    doubtful = np.flatnonzero(~(clearance(places, gantry) > 0.0))
    blocked = np.zeros(len(places), dtype=bool)
    for touch in Judge(gantry).touches(places[doubtful]):
        if touch.distance < -_OVERLAP:
            blocked[doubtful[touch.sample]] = True
    return blocked


# --- what -------------------------------------------------------------------------------------------------------------


def _mean_impact(
    gantry: Scene, impact: ImpactCost, places: Float[Array, "cell 3"], speed: float, angles: Float[Array, " direction"]
) -> Float[Array, "cell entity"]:
    """Compute the mean impact over directions of motion, by entity."""
    falls = np.array([name in FALLING for name in gantry.components])
    severity = impact.severity(gantry) * falls[:, None]
    own = impact.own(gantry)
    total = np.zeros((len(places), len(gantry.entities) + (own is not None)))
    for angle in angles:
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        for start in range(0, len(places), _CHUNK):
            c = places[start : start + _CHUNK]
            batch = StateBatch(gantry, c, np.broadcast_to(direction, c.shape), np.full(len(c), speed))
            parts = [np.einsum("nce,ce->ne", _let_go(impact.interaction, batch), severity)]
            if own is not None:
                parts.append(own.severity * _lost(impact.interaction, batch, own.fragility)[:, None])
            total[start : start + _CHUNK] += np.concatenate(parts, axis=1)
    return total / len(angles)


def _let_go(interaction: InteractionModel, batch: StateBatch) -> Float[Array, "n component entity"]:
    """Compute P given that the gripper lets go, also for models with other kinds of failure."""
    weight = _drops(interaction)
    return interaction.probability(batch) if weight is None else interaction.sources(batch)["drop"] / weight


def _lost(interaction: InteractionModel, batch: StateBatch, fragility: FragilityTable) -> Float[Array, " n"]:
    """Compute the probability that the object itself is damaged, given that the gripper lets go."""
    lost, weight = interaction.own_loss(batch, fragility), _drops(interaction)
    return np.asarray(sum(lost.values())) if weight is None else lost["drop"] / weight


def _drops(interaction: InteractionModel) -> float | None:
    """Weight of drops among the failures; None if the model does not resolve kinds of failure."""
    faults = interaction.fault_shares().get("drop")
    weight = None if faults is None else math.fsum(faults.values())
    if weight is not None and not weight > 0.0:
        raise SettingError("impact", interaction, "a model in which the gripper can let go")
    return weight

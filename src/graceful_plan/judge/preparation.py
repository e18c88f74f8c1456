"""Data that the judge prepares once per layout of a scene: pairs of geoms to check, and MuJoCo data for the checks."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Int
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.placement import Placement, PlacementPool
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.specs import within_memory

_MAX_GROUPS = 31
"""MuJoCo's collision masks have 32 bits."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Filters:
    """Geom pairs to check, and matching collision masks."""

    checked: Bool[Array, "geom geom"]
    """Pairs that must not touch."""
    ends: Bool[Array, "geom geom"]
    """Checked pairs that may touch at the ends of a path."""
    movers: frozenset[int]
    """Geoms of the robot and the carried object."""
    contype: Int[Array, " geom"]
    conaffinity: Int[Array, " geom"]
    """Collision masks of a model in which MuJoCo tests few unnecessary pairs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """Data shared by the judges of all scenes of one layout."""

    filters: Filters
    placements: PlacementPool
    """Placements with these masks."""


@per_layout
def prepare(scene: Scene) -> Prepared:
    """Return the data shared by judges of scenes that differ only in the positions of surroundings; cached."""
    with within_memory(f"judging scene {scene.name!r} with {scene.model.ngeom} geoms"):
        filters = _filters(scene)
        return Prepared(filters=filters, placements=PlacementPool((filters.contype, filters.conaffinity)))


def _filters(scene: Scene) -> Filters:
    n = scene.model.ngeom
    checked = np.zeros((n, n), dtype=bool)
    first, second = scene.collision_pairs().T
    movers = frozenset(first.tolist())
    checked[first, second] = checked[second, first] = True
    ends = np.zeros((n, n), dtype=bool)
    for a, b in scene.allowed_pairs("ends"):
        ends[a, b] = ends[b, a] = True
    contype, conaffinity = _masks(scene.model, checked)
    return Filters(checked=checked, ends=ends, movers=movers, contype=contype, conaffinity=conaffinity)


def _masks(model: mujoco.MjModel, checked: Bool[Array, "geom geom"]) -> tuple[Int[Array, " geom"], Int[Array, " geom"]]:
    """Return collision masks that exclude pairs without a check, as long as there are enough bits.

    Geoms with the same partners share a bit of `conaffinity`; the `contype` of a geom has the bits of its partners.
    """
    # Grouped by their bytes: sorting the rows of thousands of geoms takes ten seconds.
    groups: dict[bytes, int] = {}
    group = [groups.setdefault(row.tobytes(), len(groups)) for row in np.packbits(checked, axis=1)]
    if len(groups) > _MAX_GROUPS:
        return np.array(model.geom_contype), np.array(model.geom_conaffinity)
    bits = 1 << np.array(group, dtype=int)
    _, first = np.unique(bits, return_index=True)
    contype = np.array([np.bitwise_or.reduce(bits[checked[geom]], initial=0) for geom in first], dtype=int)
    return contype[group], bits


def own_placement(scene: Scene) -> Placement:
    """Return this thread's placement in a scene, whose data is valid until the next call of `place`."""
    return prepare(scene).placements.of(scene)

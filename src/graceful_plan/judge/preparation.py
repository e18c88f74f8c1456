"""What the judge prepares once per layout of a scene: pairs of geoms to look at, and MuJoCo's data to look with."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Bool, Int
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.placement import Placement, PlacementPool
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.screening import within_memory

Array = np.ndarray

_MAX_GROUPS = 31
"""MuJoCo's collision masks have 32 bits."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Filters:
    """What may touch what."""

    checked: Bool[Array, "geom geom"]
    """Pairs that may not touch."""
    ends: Bool[Array, "geom geom"]
    """Those of them that may at the ends of a path."""
    movers: frozenset[int]
    """Geoms of the robot and what it carries."""
    contype: Int[Array, " geom"]
    conaffinity: Int[Array, " geom"]
    """Masks of a model that tests few pairs needlessly."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """What judges of scenes of one layout share."""

    filters: Filters
    placements: PlacementPool
    """With these masks."""


@per_layout
def prepare(scene: Scene) -> Prepared:
    """Return what judges of scenes share that differ only by where things around the robot stand; made once."""
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
    """Return collision masks under which pairs that need no check are not tested, as far as bits last.

    Geoms with the same partners share a bit of `conaffinity`; a geom has in `contype` the bits of its partners.
    """
    # By their bytes: sorting the rows of thousands of geoms takes ten seconds.
    groups: dict[bytes, int] = {}
    group = [groups.setdefault(row.tobytes(), len(groups)) for row in np.packbits(checked, axis=1)]
    if len(groups) > _MAX_GROUPS:
        return np.array(model.geom_contype), np.array(model.geom_conaffinity)
    bits = 1 << np.array(group, dtype=int)
    _, first = np.unique(bits, return_index=True)
    contype = np.array([np.bitwise_or.reduce(bits[checked[geom]], initial=0) for geom in first], dtype=int)
    return contype[group], bits


def own_placement(scene: Scene) -> Placement:
    """Return this thread's placement in a scene: for who reads what it needs before anybody else is asked."""
    return prepare(scene).placements.of(scene)

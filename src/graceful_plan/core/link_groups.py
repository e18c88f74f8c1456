"""Groups of the robot's geoms on one frame that may touch the same geoms; each group is a link of the kernels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Int
from graceful_plan.core.frames import MovingFrames, moving_frames, reference_data
from graceful_plan.scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class LinkGroup:
    """Geoms on one frame that may touch the same geoms."""

    frame: int
    geoms: tuple[int, ...]
    partners: frozenset[int]


def link_groups(scene: Scene, frames: MovingFrames) -> list[LinkGroup]:
    """Group the geoms of robot and carried object that may touch anything, in the order of their frames."""
    moving = {geom for name in ("body", "carried") if name in scene.components for geom in scene.components[name].geoms}
    bodies = np.asarray(scene.model.geom_bodyid)
    moving |= set(np.flatnonzero(np.isin(bodies, list(scene.robot_bodies))).tolist())
    first, second = scene.collision_pairs().T
    back = np.isin(second, list(moving))
    geoms, row = np.unique(np.concatenate([first, second[back]]), return_inverse=True)
    partners = np.zeros((len(geoms), scene.model.ngeom), dtype=bool)
    partners[row, np.concatenate([second, first[back]])] = True
    held = set(scene.components["carried"].geoms) if "carried" in scene.components else set()
    by_key: dict[tuple[int, bytes, bool], list[int]] = {}
    for k, geom in enumerate(geoms.tolist()):
        key = (frames.of_body[bodies[geom]], partners[k].tobytes(), geom in held)
        by_key.setdefault(key, []).append(k)
    return [
        LinkGroup(
            frame=frame,
            geoms=tuple(geoms[rows].tolist()),
            partners=frozenset(np.flatnonzero(partners[rows[0]]).tolist()),
        )
        for (frame, _, _), rows in sorted(by_key.items(), key=lambda one: (one[0][0], one[1]))
    ]


def overlapping_geoms(model: mujoco.MjModel, data: mujoco.MjData) -> frozenset[tuple[int, int]]:
    """Return the pairs of geoms, in both orders, that overlap at the reference configuration by exact geometry."""
    mujoco.mj_collision(model, data)
    pairs = data.contact.geom[data.contact.dist < 0.0].tolist()
    return frozenset((a, b) for pair in pairs for a, b in (pair, pair[::-1]))


def link_geoms(scene: Scene) -> tuple[tuple[int, ...], ...]:
    """Return the geoms that the spheres of each link cover; frames have none."""
    frames = moving_frames(scene, reference_data(scene))
    return (*((),) * len(frames.parent), *(group.geoms for group in link_groups(scene, frames)))


def touchable_geoms(groups: list[LinkGroup], pair: Int[Array, " 2"]) -> list[tuple[int, int]]:
    """Return the pairs of geoms of two groups that may touch."""
    first, second = (groups[k] for k in pair.tolist())
    return [(a, b) for a in first.geoms for b in second.geoms if b in first.partners]


def overlaps(group: LinkGroup, others: Iterable[int], overlapping: frozenset[tuple[int, int]]) -> bool:
    """Return whether a geom of a group overlaps one of `others` that it may touch."""
    return any((a, b) in overlapping for a in group.geoms for b in group.partners.intersection(others))

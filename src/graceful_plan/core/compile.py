"""Compile a scene to arrays; features that the kernels cannot represent are refused by name.

Frames: W world, L link, P parent link, G geom, T tool. A link is a joint with everything rigidly attached to it.
Rigid links without a joint group the geoms of one frame that may touch the same geoms. So each pair of links, and
each pair of a link and an obstacle, is either tested as a whole or not at all.

Geoms on one frame keep their distance in all configurations: the carried object and the last link, for example, or
the base and its surroundings. Pairs that are apart are not tested, since the covering spheres might overlap where the
geoms never touch. Pairs that overlap are tested, so that no configuration is free; the exact judge agrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.arrays import ImpactArrays, RobotArrays, WorldArrays
from graceful_plan.core.covers import GroupCover, geom_name, group_cover
from graceful_plan.core.frames import MovingFrames, moving_frames, pose_matrix, reference_data
from graceful_plan.core.kernels import CAPACITY, Kernels
from graceful_plan.core.link_groups import LinkGroup, link_groups, overlapping_geoms, overlaps, touchable_geoms
from graceful_plan.core.obstacles import Obstacles, find_obstacles, world_arrays
from graceful_plan.core.slack import self_slack
from graceful_plan.core.sphere_cover import MAX_PROTRUSION
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.per_scene import per_layout, per_scene
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.specs import within_memory

_GEOM = mujoco.mjtGeom
_FACTORS = (1.0, 1.5, 2.0, 3.0)
"""Factors on the protrusion of spheres, tried in this order until the spheres fit into the kernels."""
_USUAL = 0.4
"""Extent of the longest links of usual arms [m]. If no factor suffices, the protrusion of longer links grows with them:
a robot ten times as large then needs as many spheres."""
PLANE_EXTENT = 50.0
"""Half side of the box that replaces an infinite plane in Algorithm 1 [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CompiledScene:
    """A scene as tables, with the kernels that read them."""

    robot: RobotArrays
    world: WorldArrays
    impact_tables: ImpactArrays
    kernels: Kernels

    @cached_property
    def proof(self) -> Kernels:
        """Kernels for proofs: never optimistic, also for pairs of links, since their slack is zero."""
        if not self.robot.self_slack.any():
            return self.kernels
        strict = replace(self.robot, self_slack=np.zeros_like(self.robot.self_slack))
        return Kernels(strict, self.world, self.impact_tables)


@per_scene
def compile_scene(scene: Scene) -> CompiledScene:
    """Compile a scene to tables and kernels, or return them if it is compiled already.

    Raises:
        UnsupportedError: If the kernels cannot represent the scene; names the geom.
        TooLargeError: If compiling needs more memory than the machine has.
    """
    with within_memory(f"compiling scene {scene.name!r} with {scene.shapes.ngeom} geoms"):
        return _compiled(scene)


def _compiled(scene: Scene) -> CompiledScene:
    data, parts = reference_data(scene), _robot_parts(scene)
    impact_tables = replace(parts.impact_tables, target_box=_world_boxes(scene.shapes, data, parts.targets))
    blocked = _blocked(scene, data, parts)
    robot = replace(
        parts.arrays,
        self_pair=np.concatenate([parts.arrays.self_pair, blocked]),
        self_slack=np.concatenate([parts.arrays.self_slack, np.zeros(len(blocked))]),
    )
    world = world_arrays(scene, data, parts.obstacles)
    return CompiledScene(
        robot=robot, world=world, impact_tables=impact_tables, kernels=Kernels(robot, world, impact_tables)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _RobotParts:
    """Tables of a scene that do not depend on where the objects around the robot are."""

    groups: list[LinkGroup]
    arrays: RobotArrays
    """Without the links of the base that touch surroundings."""
    impact_tables: ImpactArrays
    """Without the boxes of entities."""
    targets: list[int]
    """The geoms of the entities."""
    obstacles: Obstacles


@per_layout
def _robot_parts(scene: Scene) -> _RobotParts:
    data = reference_data(scene)
    frames = moving_frames(scene, data)
    groups = link_groups(scene, frames)
    impact_tables = _impact_arrays(scene, data, frames)
    arrays = _robot_arrays(scene, data, frames, groups)
    pairs = _self_pairs(groups, len(frames.parent), overlapping_geoms(scene.model, data))
    arrays = replace(arrays, self_pair=pairs, self_slack=np.zeros(len(pairs)))
    _check_capacity(scene.model, groups, arrays, impact_tables)
    touchable = [touchable_geoms(groups, pair - len(frames.parent)) for pair in pairs]
    return _RobotParts(
        groups=groups,
        arrays=replace(arrays, self_slack=self_slack(scene, arrays, touchable, impact_tables)),
        impact_tables=impact_tables,
        targets=[geom for entity in scene.entities.values() for geom in entity.geoms],
        obstacles=find_obstacles(scene, groups),
    )


def _check_capacity(
    model: mujoco.MjModel, groups: list[LinkGroup], robot: RobotArrays, impact_tables: ImpactArrays
) -> None:
    counts = {
        "joints": len(robot.lower),
        "links": len(robot.parent),
        "spheres": len(robot.sphere),
        "parts": len(impact_tables.part_link),
        "entities": impact_tables.severity.shape[1],
    }
    for what, count in counts.items():
        if count <= CAPACITY[what]:
            continue
        hint = ""
        if what == "spheres":
            largest = max((geom for group in groups for geom in group.geoms), key=lambda g: float(model.geom_rbound[g]))
            hint = f"; the largest geom that moves is {geom_name(model, largest)!r}: carry or model something smaller"
        raise UnsupportedError(f"the scene has {count} {what}, the kernels hold {CAPACITY[what]}{hint}")


def _robot_arrays(
    scene: Scene,
    data: mujoco.MjData,
    frames: MovingFrames,
    groups: list[LinkGroup],
) -> RobotArrays:
    n_frame = len(frames.parent)
    parent, joint, slide, X_PL = list(frames.parent), [-1, *range(n_frame - 1)], [0] * n_frame, []
    for frame, p in enumerate(frames.parent):
        if frame == 0:
            X_PL.append(np.eye(4))
            continue
        adr = scene.qpos_adr[frame - 1]
        slide[frame] = int(scene.model.jnt_type[scene.model.jnt_qposadr == adr][0] == mujoco.mjtJoint.mjJNT_SLIDE)
        X = np.linalg.inv(frames.X_W[p]) @ frames.X_W[frame]
        X_PL.append(X @ _joint_motion(-frames.reference[frame - 1], bool(slide[frame])))
    spheres, links, bound = [], [], {}
    protrusion = 0.0
    for group, cover in zip(groups, _covers(scene.model, data, frames, groups), strict=True):
        link = len(parent)
        parent.append(group.frame)
        joint.append(-1)
        slide.append(0)
        X_PL.append(np.eye(4))
        protrusion = max(protrusion, cover.protrusion)
        spheres.append(cover.spheres)
        links += [link] * len(cover.spheres)
        bound[link] = cover.bound
    tool = data.site(scene.tool)
    tool_frame = frames.of_body[scene.model.site_bodyid[scene.model.site(scene.tool).id]]
    arrays = RobotArrays(
        parent=np.array(parent),
        joint=np.array(joint),
        slide=np.array(slide),
        X_PL=np.stack(X_PL),
        lower=scene.limits.position[:, 0].copy(),
        upper=scene.limits.position[:, 1].copy(),
        tool_link=tool_frame,
        X_LT=np.linalg.inv(frames.X_W[tool_frame]) @ pose_matrix(tool.xmat, tool.xpos),
        sphere_link=np.array(links, dtype=int),
        sphere=np.concatenate(spheres) if spheres else np.zeros((0, 4)),
        bound=np.stack([bound.get(link, np.array([0.0, 0.0, 0.0, -1.0])) for link in range(len(parent))]),
        self_pair=np.zeros((0, 2), dtype=int),
        self_slack=np.zeros(0),
        protrusion=protrusion,
    )
    return arrays


def _covers(
    model: mujoco.MjModel, data: mujoco.MjData, frames: MovingFrames, groups: list[LinkGroup]
) -> list[GroupCover]:
    """Cover all links by spheres, with the smallest protrusion at which the kernels can hold them.

    If a uniform protrusion does not suffice, that of links longer than `_USUAL` grows with their extent.
    """
    X_LG = [
        np.stack(
            [
                np.linalg.inv(frames.X_W[group.frame]) @ pose_matrix(data.geom_xmat[geom], data.geom_xpos[geom])
                for geom in group.geoms
            ]
        )
        for group in groups
    ]
    extents = [2.0 * float(model.geom_aabb[list(group.geoms), 3:].max()) for group in groups]
    scales = [1.0] * len(groups), [max(1.0, extent / _USUAL) for extent in extents]
    covers: list[GroupCover] = []
    for scale, factor in product(scales, _FACTORS):
        covers = [
            group_cover(model, group.geoms, X, base=group.frame == 0, protrusion=factor * size * MAX_PROTRUSION)
            for group, X, size in zip(groups, X_LG, scale, strict=True)
        ]
        if sum(len(cover.spheres) for cover in covers) <= CAPACITY["spheres"]:
            break
    return covers


def _joint_motion(amount: float, slide: bool) -> Float[Array, "4 4"]:
    X = np.eye(4)
    if slide:
        X[2, 3] = amount
    else:
        X[:2, :2] = [[np.cos(amount), -np.sin(amount)], [np.sin(amount), np.cos(amount)]]
    return X


def _self_pairs(groups: list[LinkGroup], n_frame: int, overlapping: frozenset[tuple[int, int]]) -> Int[Array, "pair 2"]:
    pairs = [
        (n_frame + a, n_frame + b)
        for a in range(len(groups))
        for b in range(a + 1, len(groups))
        if groups[a].partners & set(groups[b].geoms)
        and (groups[a].frame != groups[b].frame or overlaps(groups[a], groups[b].geoms, overlapping))
    ]
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _blocked(scene: Scene, data: mujoco.MjData, parts: _RobotParts) -> Int[Array, "pair 2"]:
    """Return the links of the base that touch obstacles, each paired with itself: such a link is never free.

    Kernels do not test the base against obstacles.
    """
    near = parts.obstacles.near_base(scene.shapes, data)
    overlapping = overlapping_geoms(scene.shapes, data) if near else frozenset()
    links = [
        len(scene.joints) + 1 + a
        for a, group in enumerate(parts.groups)
        if group.frame == 0 and overlaps(group, parts.obstacles.geom.tolist(), overlapping)
    ]
    return np.repeat(np.array(links, dtype=int)[:, None], 2, axis=1)


def _impact_arrays(scene: Scene, data: mujoco.MjData, frames: MovingFrames) -> ImpactArrays:
    model = scene.model
    parts = [(r, geom) for r, component in enumerate(scene.components.values()) for geom in component.geoms]
    boxes = []
    for _, geom in parts:
        frame = frames.of_body[model.geom_bodyid[geom]]
        X = np.linalg.inv(frames.X_W[frame]) @ pose_matrix(data.geom_xmat[geom], data.geom_xpos[geom])
        centre = X[:3, :3] @ model.geom_aabb[geom, :3] + X[:3, 3]
        boxes.append(np.concatenate([X[:3, :3].ravel(), centre, model.geom_aabb[geom, 3:]]))
    targets = [e for e, entity in enumerate(scene.entities.values()) for _ in entity.geoms]
    severity = [[entity.severity[name] for entity in scene.entities.values()] for name in scene.components]
    return ImpactArrays(
        part_component=np.array([r for r, _ in parts], dtype=int),
        part_link=np.array([frames.of_body[model.geom_bodyid[geom]] for _, geom in parts], dtype=int),
        part_box=np.array(boxes).reshape(-1, 15),
        target_entity=np.array(targets, dtype=int),
        target_box=np.zeros((len(targets), 6)),
        severity=np.array(severity, dtype=float).reshape(len(scene.components), len(scene.entities)),
    )


def _world_boxes(model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int]) -> Float[Array, "target 6"]:
    R, size, aabb = data.geom_xmat[geoms].reshape(-1, 3, 3), model.geom_size[geoms], model.geom_aabb[geoms]
    plane = (model.geom_type[geoms] == int(_GEOM.mjGEOM_PLANE))[:, None]
    half = np.where(plane, np.where(size > 0, size, PLANE_EXTENT) * [1.0, 1.0, 0.0], aabb[:, 3:])
    centre = np.einsum("tij,tj->ti", R, np.where(plane, 0.0, aabb[:, :3])) + data.geom_xpos[geoms]
    reach = np.einsum("tij,tj->ti", np.abs(R), half)
    return np.concatenate([centre - reach, centre + reach], axis=1)

"""Compile a scene to arrays; features that the kernels cannot represent are refused by name.

Frames: W world, L link, P parent link, G geom, T tool. A link is a joint with everything rigidly attached to it.
Rigid links without a joint group the geoms of one frame that may touch the same geoms. So each pair of links, and
each pair of a link and an obstacle, is either tested as a whole or not at all.

Geoms on one frame keep their distance in all configurations: the carried object and the last link, for example, or
the base and its surroundings. Pairs that are apart are not tested, since the covering spheres might overlap where the
geoms never touch. Pairs that overlap are tested, so that no configuration is free; the exact judge agrees.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.core.arrays import OBSTACLE_TYPES, ImpactArrays, RobotArrays, WorldArrays
from graceful_plan.core.covers import GEOM_KINDS, GroupCover, geom_name, group_cover, hull_triangles
from graceful_plan.core.kernels import CAPACITY, Kernels
from graceful_plan.core.slack import self_slack
from graceful_plan.core.sphere_cover import MAX_PROTRUSION
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.per_scene import per_layout, per_scene
from graceful_plan.scene.placement import PlacementPool
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.screening import within_memory

Array = np.ndarray

_GEOM = mujoco.mjtGeom
_PROTRUSIONS = tuple(factor * MAX_PROTRUSION for factor in (1.0, 1.5, 2.0, 3.0))
"""Protrusions of spheres [m], tried in this order until the spheres fit into the kernels."""
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
    with within_memory(f"compiling scene {scene.name!r} with {scene.model.ngeom} geoms"):
        return _compiled(scene)


def _compiled(scene: Scene) -> CompiledScene:
    data, parts = reference_data(scene), _robot_parts(scene)
    impact_tables = replace(parts.impact_tables, target_box=_world_boxes(scene.model, data, parts.targets))
    blocked = _blocked(scene, data, parts)
    robot = replace(
        parts.arrays,
        self_pair=np.concatenate([parts.arrays.self_pair, blocked]),
        self_slack=np.concatenate([parts.arrays.self_slack, np.zeros(len(blocked))]),
    )
    world = _world_arrays(scene, data, parts.obstacles)
    return CompiledScene(
        robot=robot, world=world, impact_tables=impact_tables, kernels=Kernels(robot, world, impact_tables)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _RobotParts:
    """Tables of a scene that do not depend on where the objects around the robot are."""

    groups: list[_Group]
    arrays: RobotArrays
    """Without the links of the base that touch surroundings."""
    impact_tables: ImpactArrays
    """Without the boxes of entities."""
    targets: list[int]
    """The geoms of the entities."""
    obstacles: _Obstacles


@per_layout
def _robot_parts(scene: Scene) -> _RobotParts:
    data = reference_data(scene)
    frames = _frames(scene, data)
    groups = _groups(scene, frames)
    impact_tables = _impact_arrays(scene, data, frames)
    arrays = _robot_arrays(scene, data, frames, groups)
    pairs = _self_pairs(groups, len(frames.parent), _overlapping(scene.model, data))
    arrays = replace(arrays, self_pair=pairs, self_slack=np.zeros(len(pairs)))
    _check_capacity(scene.model, groups, arrays, impact_tables)
    touchable = [_touchable(groups, pair - len(frames.parent)) for pair in pairs]
    return _RobotParts(
        groups=groups,
        arrays=replace(arrays, self_slack=self_slack(scene, arrays, touchable, impact_tables)),
        impact_tables=impact_tables,
        targets=[geom for entity in scene.entities.values() for geom in entity.geoms],
        obstacles=_obstacles(scene, groups),
    )


def _check_capacity(
    model: mujoco.MjModel, groups: list[_Group], robot: RobotArrays, impact_tables: ImpactArrays
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


# --- kinematics -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Frames:
    """Moving frames: 0 is the base, k + 1 belongs to planned joint k."""

    parent: list[int]
    X_W: Float[Array, "frame 4 4"]  # at the reference configuration
    reference: Float[Array, " nq"]
    of_body: list[int]


def reference_data(scene: Scene) -> mujoco.MjData:
    """Return the scene with all planned joints at their reference position, where joint rotations are the identity.

    The returned data is shared: the next call in this thread for a scene of the same layout overwrites it.
    """
    return _placements(scene).of(scene).place(scene.model.qpos0[scene.qpos_adr])


@per_layout
def _placements(scene: Scene) -> PlacementPool:
    del scene
    return PlacementPool()


def _pose(rotation: Array, position: Array) -> Float[Array, "4 4"]:
    X = np.eye(4)
    X[:3, :3] = np.reshape(rotation, (3, 3))
    X[:3, 3] = position
    return X


def _frames(scene: Scene, data: mujoco.MjData) -> _Frames:
    model = scene.model
    joint_ids = [int(np.flatnonzero(model.jnt_qposadr == adr)[0]) for adr in scene.qpos_adr]
    frame_of_joint = {joint: k + 1 for k, joint in enumerate(joint_ids)}
    of_body, parent, X_W = [0] * model.nbody, [-1] + [0] * len(joint_ids), [np.eye(4)] * (len(joint_ids) + 1)
    for body in range(1, model.nbody):
        frame = of_body[model.body_parentid[body]]
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if joint not in frame_of_joint:
                continue
            parent[frame_of_joint[joint]], frame = frame, frame_of_joint[joint]
            X_W[frame] = _pose(_rotation_with_z(data.xaxis[joint]), data.xanchor[joint])
        of_body[body] = frame
    if scene.carried is not None:
        tool_body = model.site_bodyid[model.site(scene.tool).id]
        root = model.body(scene.carried.body).id
        for body in range(model.nbody):
            if _is_below(model, body, root):
                of_body[body] = of_body[tool_body]
    return _Frames(parent=parent, X_W=np.stack(X_W), reference=model.qpos0[scene.qpos_adr].copy(), of_body=of_body)


def _is_below(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body > 0 and body != root:
        body = int(model.body_parentid[body])
    return body == root


def _rotation_with_z(axis: Array) -> Float[Array, "3 3"]:
    R, z = np.empty((3, 3)), axis / np.linalg.norm(axis)
    a, b, c = z.tolist()
    # The unit vector farthest from z, crossed with z.
    x = ((0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0))[int(np.argmin(np.abs(z)))]
    d, e, f = (np.array(x) / np.linalg.norm(x)).tolist()
    R[:, 0], R[:, 1], R[:, 2] = (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d), z
    return R


def body_frames(scene: Scene) -> tuple[int, ...]:
    """Return the frame of each body: 0 if it does not move, k + 1 on planned joint k."""
    return tuple(_frames(scene, reference_data(scene)).of_body)


def link_geoms(scene: Scene) -> tuple[tuple[int, ...], ...]:
    """Return the geoms that the spheres of each link cover; frames have none."""
    frames = _frames(scene, reference_data(scene))
    return (*((),) * len(frames.parent), *(group.geoms for group in _groups(scene, frames)))


# --- geoms of the robot ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Group:
    """Geoms on one frame that may touch the same geoms."""

    frame: int
    geoms: tuple[int, ...]
    partners: frozenset[int]


def _groups(scene: Scene, frames: _Frames) -> list[_Group]:
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
        _Group(
            frame=frame,
            geoms=tuple(geoms[rows].tolist()),
            partners=frozenset(np.flatnonzero(partners[rows[0]]).tolist()),
        )
        for (frame, _, _), rows in sorted(by_key.items(), key=lambda one: (one[0][0], one[1]))
    ]


def _overlapping(model: mujoco.MjModel, data: mujoco.MjData) -> frozenset[tuple[int, int]]:
    """Return the pairs of geoms, in both orders, that overlap at the reference configuration by exact geometry."""
    mujoco.mj_collision(model, data)
    pairs = data.contact.geom[data.contact.dist < 0.0].tolist()
    return frozenset((a, b) for pair in pairs for a, b in (pair, pair[::-1]))


def _robot_arrays(
    scene: Scene,
    data: mujoco.MjData,
    frames: _Frames,
    groups: list[_Group],
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
        X_LT=np.linalg.inv(frames.X_W[tool_frame]) @ _pose(tool.xmat, tool.xpos),
        sphere_link=np.array(links, dtype=int),
        sphere=np.concatenate(spheres) if spheres else np.zeros((0, 4)),
        bound=np.stack([bound.get(link, np.array([0.0, 0.0, 0.0, -1.0])) for link in range(len(parent))]),
        self_pair=np.zeros((0, 2), dtype=int),
        self_slack=np.zeros(0),
        protrusion=protrusion,
    )
    return arrays


def _covers(model: mujoco.MjModel, data: mujoco.MjData, frames: _Frames, groups: list[_Group]) -> list[GroupCover]:
    """Cover all links by spheres, with the smallest protrusion at which the kernels can hold them."""
    X_LG = [
        np.stack(
            [
                np.linalg.inv(frames.X_W[group.frame]) @ _pose(data.geom_xmat[geom], data.geom_xpos[geom])
                for geom in group.geoms
            ]
        )
        for group in groups
    ]
    covers: list[GroupCover] = []
    for protrusion in _PROTRUSIONS:
        covers = [
            group_cover(model, group.geoms, X, base=group.frame == 0, protrusion=protrusion)
            for group, X in zip(groups, X_LG, strict=True)
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


def _self_pairs(groups: list[_Group], n_frame: int, overlapping: frozenset[tuple[int, int]]) -> Int[Array, "pair 2"]:
    pairs = [
        (n_frame + a, n_frame + b)
        for a in range(len(groups))
        for b in range(a + 1, len(groups))
        if groups[a].partners & set(groups[b].geoms)
        and (groups[a].frame != groups[b].frame or _overlap(groups[a], groups[b].geoms, overlapping))
    ]
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _blocked(scene: Scene, data: mujoco.MjData, parts: _RobotParts) -> Int[Array, "pair 2"]:
    """Return the links of the base that touch obstacles, each paired with itself: such a link is never free.

    Kernels do not test the base against obstacles.
    """
    near = parts.obstacles.near_base(scene.model, data)
    overlapping = _overlapping(scene.model, data) if near else frozenset()
    links = [
        len(scene.joints) + 1 + a
        for a, group in enumerate(parts.groups)
        if group.frame == 0 and _overlap(group, parts.obstacles.geom.tolist(), overlapping)
    ]
    return np.repeat(np.array(links, dtype=int)[:, None], 2, axis=1)


def _touchable(groups: list[_Group], pair: Int[Array, " 2"]) -> list[tuple[int, int]]:
    """Return the pairs of geoms of two groups that may touch."""
    first, second = (groups[k] for k in pair.tolist())
    return [(a, b) for a in first.geoms for b in second.geoms if b in first.partners]


def _overlap(group: _Group, others: Iterable[int], overlapping: frozenset[tuple[int, int]]) -> bool:
    return any((a, b) in overlapping for a in group.geoms for b in group.partners.intersection(others))


# --- obstacles ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class _Obstacles:
    """Geoms around the robot, with the tables that do not depend on where they are.

    | field   | meaning                                                        | unit | shape        |
    |---------|----------------------------------------------------------------|------|--------------|
    | geom    | ids, ascending                                                 |      | obstacle     |
    | kind    | as in `WorldArrays`                                            |      | obstacle     |
    | ignores | as in `WorldArrays`                                            |      | obstacle     |
    | hulls   | corners of triangles of meshes' hulls, in the geom's frame     | m    |              |
    | base    | geoms of the base                                              |      | geom         |
    """

    geom: Int[Array, " obstacle"]
    kind: Int[Array, " obstacle"]
    ignores: Int[Array, " obstacle"]
    hulls: tuple[Float[Array, "_ 3 3"], ...]
    base: Int[Array, " geom"]

    def near_base(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Return whether the bounding sphere of an obstacle meets that of a geom of the base; planes count as near."""
        radius = np.where(model.geom_rbound > 0.0, model.geom_rbound, np.inf)
        away = np.linalg.norm(data.geom_xpos[self.geom][:, None] - data.geom_xpos[self.base], axis=2)
        return bool(np.any(away <= radius[self.geom][:, None] + radius[self.base]))


def _obstacles(scene: Scene, groups: list[_Group]) -> _Obstacles:
    model = scene.model
    moving = {geom for group in groups for geom in group.geoms}
    geoms = sorted({g for group in groups for g in group.partners} - moving)
    n_frame = len(scene.joints) + 1
    kind, ignores, hulls = [], [], []
    for geom in geoms:
        name = GEOM_KINDS.get(_GEOM(int(model.geom_type[geom])))
        if name is None:
            raise UnsupportedError(f"geom {geom_name(model, geom)!r} is a {_GEOM(int(model.geom_type[geom])).name}; "
                                   f"supported: {', '.join(OBSTACLE_TYPES)}")  # fmt: skip
        kind.append(OBSTACLE_TYPES.index(name))
        ignores.append(
            sum(1 << (n_frame + k) for k, group in enumerate(groups[: 62 - n_frame]) if geom not in group.partners)
        )
        mesh = name == "mesh"
        hulls.append(hull_triangles(model, int(model.geom_dataid[geom])) if mesh else np.zeros((0, 3, 3)))
    return _Obstacles(
        geom=np.array(geoms, dtype=int),
        kind=np.array(kind, dtype=int),
        ignores=np.array(ignores, dtype=int),
        hulls=tuple(hulls),
        base=np.array([geom for group in groups if group.frame == 0 for geom in group.geoms], dtype=int),
    )


def _world_arrays(scene: Scene, data: mujoco.MjData, obstacles: _Obstacles) -> WorldArrays:
    model = scene.model
    # Nearest to the base first, since these obstacles collide most often.
    away = np.linalg.norm(data.geom_xpos[obstacles.geom] - data.xpos[min(scene.robot_bodies)], axis=1)
    order = np.argsort(away - model.geom_rbound[obstacles.geom], kind="stable")
    geoms = obstacles.geom[order]
    hulls = [
        obstacles.hulls[k] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        for k, geom in zip(order.tolist(), geoms.tolist(), strict=True)
        if len(obstacles.hulls[k])
    ]
    size = [len(obstacles.hulls[k]) for k in order.tolist()]
    pose = np.concatenate([data.geom_xmat[geoms], data.geom_xpos[geoms]], axis=1)
    radius = np.where(model.geom_type[geoms] == int(_GEOM.mjGEOM_PLANE), -1.0, model.geom_rbound[geoms] + 1e-6)
    return WorldArrays(
        kind=obstacles.kind[order],
        pose=pose,
        size=model.geom_size[geoms].reshape(-1, 3),
        bound=np.column_stack([pose[:, 9:], radius]),
        ignores=obstacles.ignores[order],
        hull_start=np.concatenate([[0], np.cumsum(size, dtype=int)]),
        triangles=np.concatenate([np.zeros((0, 3, 3)), *hulls]),
        geom=geoms,
    )


# --- impact --------------------------------------------------------------------------------------------------------


def _impact_arrays(scene: Scene, data: mujoco.MjData, frames: _Frames) -> ImpactArrays:
    model = scene.model
    parts = [(r, geom) for r, component in enumerate(scene.components.values()) for geom in component.geoms]
    boxes = []
    for _, geom in parts:
        frame = frames.of_body[model.geom_bodyid[geom]]
        X = np.linalg.inv(frames.X_W[frame]) @ _pose(data.geom_xmat[geom], data.geom_xpos[geom])
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

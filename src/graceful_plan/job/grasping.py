"""Grasps of an object between two pads: antipodal contacts on its geoms, with opening, approach and quality.

Frames: W world, T tool, O object, G geom. Each colliding geom of the object is grasped by itself, so the wall of a cup
and the handle of a pot each give grasps; a grasp in which the gripper would touch other parts of the object is
discarded. Surroundings do not count here, because they change during a job.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.grasp import GraspHolds, load_facets
from graceful_plan.core.frames import pose_matrix
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.job.gripper import ParallelGripper, find_gripper
from graceful_plan.job.placed import Placed
from graceful_plan.path import is_real
from graceful_plan.query.arguments import checked_seed
from graceful_plan.scene.elements import Fingers
from graceful_plan.scene.roles import held_note, rigid_pose
from graceful_plan.scene.scene import Scene

Array = np.ndarray

JOINED = "@joined"
"""Ending of the names of bodies that lie on an object without being fixed to it, such as a lid: no grasp is there."""
_GEOM = mujoco.mjtGeom
_AIR = 0.01
"""Distance between each pad and the object while the gripper approaches [m]."""
_CLEAR = 0.001
"""Least distance of the open gripper from the object [m]."""
_FLOOR = 0.003
"""Least height of the gripper above the underside of the object [m], which stands on something."""
_FROM_BELOW = 0.1
"""Largest upward component of the approach: an object that stands is not grasped from below."""
_HOLDS = 0.95
"""Largest load at rest as a fraction of the pads' capacity, as in `GraspHolds`."""
_TURNS = np.deg2rad([0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0])
"""Approach directions about the closing axis that are tried."""
_ROUND = 12
"""Closing directions across a round geom that are tried."""
_POINTS = 64
"""Points on a mesh from which contacts are sought."""
_FRICTION = 0.5
"""Tangent of half the friction cone within which contacts on a mesh oppose each other."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Grasp:
    """How a gripper holds an object. `scene.attach(name, X_TO=grasp.X_TO, fingers=grasp.fingers)` holds it.

    Args:
        X_TO: Pose of the object's body in the tool frame.
        fingers: Positions of the finger joints while holding; as in `Scene.attach`.
        opening: Distance of the pads while the gripper approaches [m]; None: the largest.
        approach: Direction in the object's frame in which the gripper arrives; by default the tool's z axis.
        quality: Share of the pads' capacity that the weight leaves free, at most 1; NaN if unknown.
    """

    X_TO: Float[Array, "4 4"]
    fingers: Fingers | None = None
    opening: float | None = None
    approach: Float[Array, " xyz"] | None = None
    quality: float = float("nan")

    def __post_init__(self) -> None:
        X_TO = rigid_pose("X_TO", self.X_TO)
        approach = X_TO[2, :3] if self.approach is None else np.asarray(self.approach, dtype=float)
        length = float(np.linalg.norm(approach))
        if approach.shape != (3,) or not length > 0.0:
            raise SettingError("approach", approach.tolist(), "a direction in the object's frame")
        object.__setattr__(self, "X_TO", X_TO)
        object.__setattr__(self, "approach", approach / length)

    def tool_at(self, X_WO: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
        """Return the pose of the tool that holds the object at a pose."""
        return X_WO @ np.linalg.inv(np.asarray(self.X_TO))


def grasps(scene: Scene, name: str, *, n: int = 16, seed: int = 0) -> tuple[Grasp, ...]:
    """Sample grasps of an object: the declared one, if any, then antipodal ones on its geoms.

    The object is assumed to stand as it does in the scene, also about a vertical axis turned or elsewhere: nothing is
    grasped from below, and the gripper keeps above the object's underside. Grasps come in turns from all sides at
    which the object can be grasped, those nearest to its centre of mass first.

    Args:
        scene: A scene with an empty gripper; its tool is between two pads that move.
        name: Object of the scene, or any body whose parent is the world.
        n: Largest number of grasps.
        seed: Seed of the directions across round geoms and of the points on meshes.

    Returns:
        Grasps that hold the object at rest by friction and pressure of the pads (see `GraspHolds`); possibly none.

    Raises:
        UnknownNameError: If there is no such object.
        UnsupportedError: If it cannot be held, or the gripper is of another kind.
    """
    if not (is_real(n) and n >= 1):
        raise SettingError("n", n, "at least 1")
    return tuple(islice(sampled_grasps(scene, name, seed=seed), int(n)))


def sampled_grasps(scene: Scene, name: str, *, seed: int = 0) -> Iterator[Grasp]:
    """Yield grasps one after the other; see `grasps`."""
    rng = checked_seed(seed)
    note = held_note(scene.model, scene.notes, scene.robot_bodies, name, X_TO=np.eye(4))
    thing = _Thing(scene, note.body)
    if (own := declared_grasp(scene, name)) is not None:
        yield own
    gripper = find_gripper(scene)
    if gripper.has_fixed_pad:
        raise UnsupportedError(
            f"a pad of {scene.name!r} is fixed, and grasps are sampled for two that move: give a list"
        )
    for candidate in _in_turns(_contacts(thing, gripper, rng), thing, gripper):
        fingers = gripper.fingers(candidate.width)
        quality = _load_left(scene.attach(name, X_TO=candidate.X_TO, fingers=fingers), thing.up)
        if quality >= 1.0 - _HOLDS:
            opening, approach = candidate.opening, candidate.approach
            yield Grasp(X_TO=candidate.X_TO, fingers=fingers, opening=opening, approach=approach, quality=quality)


def handle_grasps(scene: Scene, body: str, handle: str, *, seed: int = 0) -> Iterator[Grasp]:
    """Yield grasps of a handle, relative to the body to which it is fixed: antipodal ones, as in `grasps`.

    Whether the pads hold it against the friction of a joint is unknown, so the quality is NaN.

    Args:
        scene: A scene with an empty gripper.
        body: Body of a door, a drawer or the like.
        handle: Geom of that body, or a body that is fixed to it.
        seed: As in `grasps`.
    """
    thing, gripper = _Thing(scene, body), find_gripper(scene)
    thing.grasped = frozenset(scene.geoms_named(handle)) & thing.grasped
    thing.underside = -np.inf  # a door stands on nothing
    chosen = [X[:3, 3] for geom, X in zip(thing.geoms, thing.X_OG, strict=True) if geom in thing.grasped]
    thing.centre = np.mean(chosen, axis=0)
    for one in _in_turns(_contacts(thing, gripper, checked_seed(seed)), thing, gripper):
        yield Grasp(X_TO=one.X_TO, fingers=gripper.fingers(one.width), opening=one.opening, approach=one.approach)


def declared_grasp(scene: Scene, name: str) -> Grasp | None:
    """Return the grasp that the scene declares for an object; None if it declares none."""
    note = scene.notes.objects.get(name)
    if note is None or note.X_TO is None:
        return None
    try:
        approach = find_gripper(scene).approach @ note.X_TO[:3, :3]
    except UnsupportedError:
        approach = None
    quality = _load_left(scene.attach(name, X_TO=note.X_TO), _Thing(scene, note.body).up)
    return Grasp(X_TO=note.X_TO, fingers=note.fingers, approach=approach, quality=quality)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidate:
    """A place between the pads, with the width there, the opening that leads to it and the approach in O."""

    approach: Float[Array, " xyz"]
    width: float
    X_TO: Float[Array, "4 4"]
    opening: float


class _Thing(Placed):
    """The object where it stands, with its upward direction, centre of mass and underside in O."""

    def __init__(self, scene: Scene, body: str) -> None:
        super().__init__(scene, body)
        R_WO, p_WO = self.X_WO[:3, :3], self.X_WO[:3, 3]
        self.up = R_WO[2].copy()
        of = self.model.geom_bodyid
        loose = {geom for geom in self.geoms if self.model.body(of[geom]).name.endswith(JOINED)}
        self.grasped = frozenset(self.geoms) - loose
        """Geoms between the pads of a grasp."""
        self.centre = R_WO.T @ (self.data.subtree_com[self.body] - p_WO)
        self.underside = min(
            float(self.up @ (X[:3, 3] + X[:3, :3] @ self.model.geom_aabb[g, :3]))
            - float(np.abs(self.up @ X[:3, :3]) @ self.model.geom_aabb[g, 3:])
            for g, X in zip(self.geoms, self.X_OG, strict=True)
        )

    def is_free(self, geoms: Sequence[int], X_TG: Float[Array, "geom 4 4"], X_TO: Float[Array, "4 4"]) -> bool:
        """Tell whether the open gripper keeps off the object and above its underside."""
        X_OG = np.linalg.inv(X_TO) @ X_TG
        box = self.model.geom_aabb[list(geoms)]
        low = (X_OG[:, :3, 3] + np.einsum("gij,gj->gi", X_OG[:, :3, :3], box[:, :3])) @ self.up
        low = low - np.einsum("gi,gi->g", np.abs(np.einsum("i,gij->gj", self.up, X_OG[:, :3, :3])), box[:, 3:])
        if float(low.min()) < self.underside + _FLOOR:
            return False
        self.move(geoms, self.X_WO @ X_OG)
        reach = self.model.geom_rbound
        for g in geoms:
            for own in self.geoms:
                away = float(np.linalg.norm(self.data.geom_xpos[g] - self.data.geom_xpos[own]))
                if away > reach[g] + reach[own] + _CLEAR:
                    continue
                if mujoco.mj_geomDistance(self.model, self.data, g, own, 2.0 * _CLEAR, None) < _CLEAR:
                    return False
        return True


def _contacts(
    thing: _Thing, gripper: ParallelGripper, rng: np.random.Generator
) -> Iterator[tuple[Float[Array, " xyz"], Float[Array, " xyz"], float, int]]:
    """Yield closing axis and middle in O, width, and index of the geom of antipodal contacts.

    The middle is that of the geom; `_in_turns` shifts it along the geom for each approach.
    """
    model = thing.model
    for k, (geom, X_OG) in enumerate(zip(thing.geoms, thing.X_OG, strict=True)):
        if geom not in thing.grasped:
            continue
        kind, size = int(model.geom_type[geom]), model.geom_size[geom]
        R, p = X_OG[:3, :3], X_OG[:3, 3]
        turn = np.pi * (np.arange(_ROUND) + rng.random()) / _ROUND
        across = np.stack([np.cos(turn), np.sin(turn), np.zeros(_ROUND)], axis=1)
        if kind == int(_GEOM.mjGEOM_BOX) or kind == int(_GEOM.mjGEOM_ELLIPSOID):
            yield from ((R @ np.eye(3)[i], p, 2.0 * float(size[i]), k) for i in range(3))
        elif kind == int(_GEOM.mjGEOM_SPHERE):
            yield from ((R @ c, p, 2.0 * float(size[0]), k) for c in across)
        elif kind in (int(_GEOM.mjGEOM_CYLINDER), int(_GEOM.mjGEOM_CAPSULE)):
            yield from ((R @ c, p, 2.0 * float(size[0]), k) for c in across)
            if kind == int(_GEOM.mjGEOM_CYLINDER):
                yield R[:, 2], p, 2.0 * float(size[1]), k
        elif kind == int(_GEOM.mjGEOM_MESH):
            for c, middle, width in _mesh_contacts(model, geom, rng):
                yield R @ c, R @ middle + p, width, k


def _mesh_contacts(
    model: mujoco.MjModel, geom: int, rng: np.random.Generator
) -> Iterator[tuple[Float[Array, " xyz"], Float[Array, " xyz"], float]]:
    """Yield closing axis, middle and width of opposing points on a mesh, in G."""
    mesh = int(model.geom_dataid[geom])
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    first, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corner = model.mesh_vert[start : start + count][model.mesh_face[first : first + faces]].astype(float)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(normal, axis=1)
    kept = area > 0.0
    corner, normal, area = corner[kept], normal[kept] / area[kept, None], area[kept]
    for face in rng.choice(len(area), size=_POINTS, p=area / area.sum()):
        a, b = np.sort(rng.random(2))
        point = corner[face].T @ np.array([a, b - a, 1.0 - b])
        distance, hit = _farthest_hit(corner, normal, point, -normal[face])
        if hit >= 0 and -normal[hit] @ normal[face] > np.cos(np.arctan(_FRICTION)):
            yield -normal[face], point - 0.5 * distance * normal[face], distance


def _farthest_hit(
    corner: Float[Array, "face 3 xyz"], normal: Float[Array, "face xyz"], point: Float[Array, " xyz"], way: Array
) -> tuple[float, int]:
    """Return distance and index of the last triangle that a ray leaves through; index -1 if there is none."""
    e1, e2, to = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], point - corner[:, 0]
    p = np.cross(way, e2)
    det = np.einsum("fi,fi->f", e1, p)
    safe = np.where(np.abs(det) > 1e-15, det, np.inf)
    u = np.einsum("fi,fi->f", to, p) / safe
    s = np.cross(to, e1)
    v, t = s @ way / safe, np.einsum("fi,fi->f", e2, s) / safe
    hit = np.isfinite(safe) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > 1e-6) & (normal @ way > 0.0)
    if not hit.any():
        return 0.0, -1
    last = int(np.argmax(np.where(hit, t, -np.inf)))
    return float(t[last]), last


def _in_turns(
    contacts: Iterator[tuple[Float[Array, " xyz"], Float[Array, " xyz"], float, int]],
    thing: _Thing,
    gripper: ParallelGripper,
) -> Iterator[_Candidate]:
    """Yield candidates from all sides in turns, in each the nearest to the centre of mass first."""
    sides: dict[tuple[object, ...], list[tuple[float, int, _Candidate]]] = {}
    number, at = 0, cache(gripper.at)
    for closing, middle, width, k in contacts:
        if not gripper.range[0] < width < gripper.range[1] - 2.0 * _CLEAR:
            continue
        opening = min(width + 2.0 * _AIR, gripper.range[1])
        X_TG, (_, between) = at(opening)[0], at(width)
        for approach in _approaches(closing, thing.up):
            for place in _places(thing, k, closing, middle, approach, gripper):
                arm = place - thing.centre
                arm = round(float(np.linalg.norm(arm - closing * (closing @ arm))), 6)  # rounding breaks no ties
                side = (k, *np.round(approach, 1).tolist(), *np.round(np.abs(closing), 1).tolist())
                X_TO = _hold(place, closing, approach, gripper, between)
                if not thing.is_free(gripper.geoms, X_TG, X_TO):
                    continue
                one = _Candidate(approach=approach, width=width, X_TO=X_TO, opening=opening)
                sides.setdefault(side, []).append((arm, number, one))
                number += 1
    queues = [sorted(side, key=lambda row: row[:2]) for side in sides.values()]
    queues.sort(key=lambda rows: rows[0][:2])
    # From above, obliquely and from the side in turns, because a place on a shelf admits other grasps than a table.
    seen: Counter[int] = Counter()
    order = []
    for rows in queues:
        tilt = round(2.0 * float(rows[0][2].approach @ thing.up))
        order.append((seen[tilt], tilt))
        seen[tilt] += 1
    queues = [queues[i] for i in sorted(range(len(queues)), key=order.__getitem__)]
    for turn in range(max((len(rows) for rows in queues), default=0)):
        yield from (rows[turn][2] for rows in queues if turn < len(rows))


def _approaches(closing: Float[Array, " xyz"], up: Float[Array, " xyz"]) -> Iterator[Float[Array, " xyz"]]:
    """Yield directions across the closing axis, without those from below; the steepest down is the first."""
    down = -up + closing * (closing @ up)
    if float(np.linalg.norm(down)) < 1e-6:
        down = np.eye(3)[int(np.argmin(np.abs(closing)))]
        down = down - closing * (closing @ down)
    down /= np.linalg.norm(down)
    side = np.cross(closing, down)
    for turn in _TURNS:
        way = np.cos(turn) * down + np.sin(turn) * side
        if way @ up <= _FROM_BELOW:
            yield way


def _places(
    thing: _Thing,
    k: int,
    closing: Float[Array, " xyz"],
    middle: Float[Array, " xyz"],
    approach: Float[Array, " xyz"],
    gripper: ParallelGripper,
) -> Iterator[Float[Array, " xyz"]]:
    """Yield places of the middle of the pads along a geom.

    They are as deep as the hand allows or with the pads just inside, and in the middle or nearer to either end.
    """
    model, geom, X = thing.model, thing.geoms[k], thing.X_OG[k]
    kind, half = int(model.geom_type[geom]), model.geom_aabb[geom, 3:]
    if kind == int(_GEOM.mjGEOM_MESH):
        yield middle
        return
    lateral = np.cross(closing, approach)
    tall, wide = (float(_support(kind, half, X[:3, :3].T @ way)) for way in (approach, lateral))
    axis = X[:3, 2]
    rounded = kind in (int(_GEOM.mjGEOM_CYLINDER), int(_GEOM.mjGEOM_CAPSULE)) and abs(closing @ axis) < 0.5
    if kind in (int(_GEOM.mjGEOM_SPHERE), int(_GEOM.mjGEOM_ELLIPSOID)):
        yield middle
    elif rounded:
        # Contacts oppose each other only where the closing axis meets the axis of the geom.
        length = float(half[2]) - (float(half[0]) if kind == int(_GEOM.mjGEOM_CAPSULE) else 0.0)
        deepest = max(length - max(gripper.depth - 2.0 * _CLEAR, 0.0), 0.0)
        shallow = max(length - gripper.half[0], 0.0)
        end = axis * -np.sign(approach @ axis) if abs(approach @ axis) > 0.5 else axis
        along = {deepest, shallow} if abs(approach @ axis) > 0.5 else {0.0, 0.5 * length, -0.5 * length, 0.8 * length}
        yield from (middle + s * end for s in sorted(along))
    else:
        deepest = max(tall - max(gripper.depth - 2.0 * _CLEAR, 0.0), 0.0)
        shallow = max(tall - gripper.half[0], 0.0)
        rims = {0.0, 0.5 * wide, -0.5 * wide}
        yield from (middle - s * approach + t * lateral for s in sorted({deepest, shallow}) for t in sorted(rims))


def _support(kind: int, half: Float[Array, " xyz"], way: Float[Array, " xyz"]) -> float:
    """Return the extent of a geom from its middle along a unit vector in G."""
    if kind == int(_GEOM.mjGEOM_CYLINDER):
        return float(np.hypot(way[0], way[1]) * half[0] + abs(way[2]) * half[2])
    return float(np.abs(way) @ half)


def _hold(
    place: Float[Array, " xyz"],
    closing: Float[Array, " xyz"],
    approach: Float[Array, " xyz"],
    gripper: ParallelGripper,
    between: Float[Array, " xyz"],
) -> Float[Array, "4 4"]:
    """Return X_TO such that the middle `between` the pads, in T, is at a place of the object."""
    of_tool = np.stack([gripper.closing, gripper.approach, np.cross(gripper.closing, gripper.approach)], axis=1)
    of_object = np.stack([closing, approach, np.cross(closing, approach)], axis=1)
    R_TO = of_tool @ of_object.T
    return pose_matrix(R_TO, between - R_TO @ place)


def _load_left(held: Scene, up: Float[Array, " xyz"]) -> float:
    """Return one minus the load of an upright object at rest, as a fraction of the pads' capacity; NaN if unknown."""
    try:
        facets, room = load_facets(GraspHolds().grip(held))
    except (UnsupportedError, SettingError):
        return float("nan")
    gravity = float(np.linalg.norm(held.model.opt.gravity))
    return 1.0 - float((facets @ up * gravity / room).max())

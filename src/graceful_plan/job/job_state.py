"""The state of the world during a job, as a value: poses of bodies, facts, configuration of the arm, and time.

Frames: W world, O object, V vessel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.axes import Upright
from graceful_plan.constraints.standing import KeepStanding
from graceful_plan.core.frames import pose_matrix
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.job.grasping import JOINED, Grasp
from graceful_plan.job.gripper import find_gripper
from graceful_plan.scene.elements import Contents, ObjectNote
from graceful_plan.scene.harm.severity import ITSELF
from graceful_plan.scene.model_parts import subtree
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.roles import FROM_ABOVE
from graceful_plan.scene.scene import Scene

Array = np.ndarray
PoseKey = tuple[float, ...]
"""A pose as 16 numbers, row by row: hashable."""

_FAR = 100.0
"""Distance to which bodies are moved that shall not be in the way [m]."""
SAME = 1e-6
"""Largest difference in an element of two poses that are the same."""
_KEPT = 512
"""Arranged scenes that are cached per scene."""


def pose_key(X: Float[Array, "4 4"]) -> PoseKey:
    """Return a pose as numbers that can be compared and hashed."""
    return tuple(float(x) for x in np.asarray(X).ravel())


def pose_of(key: PoseKey) -> Float[Array, "4 4"]:
    """Return the pose of a key."""
    return np.array(key).reshape(4, 4)


@dataclass(frozen=True, kw_only=True, eq=False)
class JobState:
    """A state of the world between two actions, with an empty gripper.

    Args:
        world: Scene of the job; lids that were closed are parts of their vessels in it.
        q: Configuration of the arm [rad or m].
        where: Pose in W of each body that is elsewhere than in `world`.
        facts: Further facts, such as ("joined", "lid"); actions read and add them.
        clock: Time since the start of the job [s]; it counts only in scenes with moving entities.
    """

    world: Scene
    q: Float[Array, " nq"]
    where: Mapping[str, PoseKey] = field(default_factory=lambda: MappingProxyType({}))
    facts: frozenset[tuple[str, ...]] = frozenset()
    clock: float = 0.0

    @cached_property
    def surroundings(self) -> tuple[object, ...]:
        """Key of everything but the arm: equal keys mean equal surroundings."""
        return id(self.world), tuple(sorted(self.where.items())), self.facts, self.moved_for

    @property
    def moved_for(self) -> float:
        """Time for which moving entities have moved [s], at most until the last of them stops."""
        return min(self.clock, max((float(entity.t[-1]) for entity in self.world.moving.values()), default=0.0))

    @property
    def is_moving(self) -> bool:
        """Tell whether a moving entity has not arrived yet."""
        return any(self.clock < entity.t[-1] for entity in self.world.moving.values())

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Key of the whole state."""
        return (*self.surroundings, self.q.tobytes())

    def pose(self, name: str) -> Float[Array, "4 4"]:
        """Return where a body is."""
        return pose_of(self.where[name]) if name in self.where else _initial_pose(self.world, name)

    def scene(self, opening: float | None = None) -> Scene:
        """Return the scene with an empty gripper, opened to a distance of the pads [m]; None for the largest."""
        return self.now(_arranged(self.world, tuple(sorted(self.where.items())), None, opening))

    def holding(self, name: str, grasp: Grasp, support: tuple[str, ...] = ()) -> Scene:
        """Return the scene with an object in the gripper, which may touch its supports at the ends of a motion."""
        others = tuple((body, X) for body, X in sorted(self.where.items()) if body != name)
        return self.now(_arranged(self.world, others, (name, grasp, support), None))

    def now(self, scene: Scene) -> Scene:
        """Return a scene with its moving entities where they are at the time of this state."""
        return _later(scene, self.moved_for) if self.moved_for else scene

    def timed(self, scene: Scene) -> Scene:
        """Return a scene of this world at another time with its moving entities where they are now."""
        now = [entity.later(-self.moved_for) for name, entity in self.world.moving.items() if name in scene.moving]
        if all(np.allclose(entity.t, scene.moving[entity.name].t, rtol=0.0, atol=SAME) for entity in now):
            return scene
        return scene.with_moving(*now)

    def moved(self, name: str, X_WO: Float[Array, "4 4"]) -> JobState:
        """Return the state with a body elsewhere."""
        return replace(self, where=MappingProxyType({**self.where, name: pose_key(X_WO)}))

    def after(self, q: Float[Array, " nq"], seconds: float) -> JobState:
        """Return the state with the arm elsewhere, some time later."""
        return replace(self, q=q, clock=self.clock + seconds)

    def knowing(self, *fact: str) -> JobState:
        """Return the state in which one more fact is true."""
        return replace(self, facts=self.facts | {fact})

    def in_world(self, world: Scene) -> JobState:
        """Return the state in a changed scene with the same bodies, such as other severities."""
        return replace(self, world=world)

    def parked(self, names: tuple[str, ...]) -> JobState:
        """Return the state with bodies far away, for questions about the world without them."""
        far = {name: _FAR + k for k, name in enumerate(sorted(names))}
        where = {name: pose_key(_shifted(self.pose(name), x)) for name, x in far.items()}
        return replace(self, where=MappingProxyType({**self.where, **where}))

    def joined(self, onto: str, name: str) -> JobState:
        """Return the state in which a body lies on another and moves with it: a lid, a thing on a tray.

        It is no longer a separate entity. Carried objects with something on them are kept upright.
        """
        X_VL = np.linalg.inv(self.pose(onto)) @ self.pose(name)
        where = {body: X for body, X in self.where.items() if body != name}
        return replace(self, world=joined_world(self.world, onto, name, pose_key(X_VL)), where=MappingProxyType(where))

    def on(self, tray: str, slots: Mapping[str, PoseKey]) -> tuple[str, ...]:
        """Return which objects stand in their slots, poses relative to a tray."""
        X_TW = np.linalg.inv(self.pose(tray))
        return tuple(
            name
            for name, slot in sorted(slots.items())
            if np.allclose(X_TW @ self.pose(name), pose_of(slot), atol=SAME)
        )

    def loaded(self, tray: str, slots: Mapping[str, PoseKey]) -> JobState:
        """Return the state in which a tray and the objects in their slots are one thing, for a motion of the tray."""
        riders = self.on(tray, slots)
        if not riders:
            return self
        where = {body: X for body, X in self.where.items() if body not in riders}
        return replace(
            self,
            world=_loaded(self.world, tray, tuple((name, slots[name]) for name in riders)),
            where=MappingProxyType(where),
            facts=self.facts | {("joined", name) for name in riders},
        )

    def with_joint(self, joint: str, position: float, along: tuple[str, ...] = ()) -> JobState:
        """Return the state with a joint of the surroundings elsewhere, and bodies moved along with its part.

        Args:
            joint: A hinge or slide that is not planned, such as that of a drawer.
            position: Its position [rad or m].
            along: Bodies that stand on or in the part.
        """
        part = self.world.model.body(int(self.world.model.joint(joint).bodyid[0])).name
        then = replace(self, world=_with_joint(self.world, joint, position))
        X_WW = _initial_pose(then.world, part) @ np.linalg.inv(_initial_pose(self.world, part))
        for name in along:
            then = then.moved(name, X_WW @ self.pose(name))
        return then

    def with_contents(self, name: str, contents: Contents | None) -> JobState:
        """Return the state in which an object has other contents; with None, nothing can leave it."""
        note = self.world.notes.objects.get(name)
        if contents == (None if note is None else note.contents):
            return self
        return replace(self, world=_with_contents(self.world, name, contents))


@per_scene(most=_KEPT)
def _later(scene: Scene, seconds: float) -> Scene:
    return scene.with_moving(*(entity.later(-seconds) for entity in scene.moving.values()))


def _shifted(X: Float[Array, "4 4"], x: float) -> Float[Array, "4 4"]:
    X = X.copy()
    X[0, 3] = x
    return X


@per_scene
def _initial_pose(scene: Scene, name: str) -> Float[Array, "4 4"]:
    body = scene.data_at(scene.home_qpos[scene.qpos_adr]).body(name)
    return pose_matrix(body.xmat, body.xpos)


@per_scene(most=_KEPT)
def _arranged(
    world: Scene,
    where: tuple[tuple[str, PoseKey], ...],
    held: tuple[str, Grasp, tuple[str, ...]] | None,
    opening: float | None,
) -> Scene:
    """Return a scene with bodies elsewhere, and an object in the gripper or the gripper open."""
    # Moved last, so that tables of the robot and the object are computed once for all arrangements.
    scene = _gripped(world, held, opening)
    return scene.edit(move={name: pose_of(X) for name, X in where}) if where else scene


@per_scene(most=_KEPT)
def _gripped(world: Scene, held: tuple[str, Grasp, tuple[str, ...]] | None, opening: float | None) -> Scene:
    if held is not None:
        name, grasp, support = held
        scene = world.attach(name, X_TO=grasp.X_TO, fingers=grasp.fingers, support=support)
        loose = _loose_geoms(scene)
        # A loose load stays on the object only if the object is kept upright, in a healthy motion as well.
        kept = [Upright(), *(KeepStanding(geom) for geom in loose)] if loose else []
        return scene.with_constraints(*scene.notes.constraints, *kept) if kept else scene
    try:
        gripper = find_gripper(world)
    except UnsupportedError:
        return world.with_state({})  # a new scene: cached values must not be the scene itself
    return world.with_state(gripper.fingers(gripper.range[1] if opening is None else opening))


def _loose_geoms(scene: Scene) -> list[str]:
    """Return the first geom of each body that lies on the carried object."""
    model = scene.model
    loose = [b for b in sorted(scene.held_bodies) if model.body(b).name.endswith(JOINED)]
    return [model.geom(int(model.body_geomadr[b])).name for b in loose]


@per_scene
def _with_joint(world: Scene, joint: str, position: float) -> Scene:
    return world.with_state({joint: position})


@per_scene
def joined_world(world: Scene, onto: str, name: str, X_VL: PoseKey) -> Scene:
    """Return the scene in which a body without its joints is a part of another, at a pose relative to it."""
    spec, quaternion = world.spec.copy(), np.empty(4)
    X = pose_of(X_VL)
    mujoco.mju_mat2Quat(quaternion, X[:3, :3].ravel())
    spec.copy_during_attach = True
    lid = spec.body(name)
    model = world.model
    parts = subtree(model, model.body(name).id)
    named = {model.body(b).name for b in parts}
    named |= {model.geom(g).name for g in range(model.ngeom) if int(model.geom_bodyid[g]) in parts}
    gone = {model.joint(j).name for j in range(model.njnt) if int(model.jnt_bodyid[j]) in parts}
    for joint in list(lid.joints):
        spec.delete(joint)
    for k, geom in enumerate(lid.geoms):
        geom.name = geom.name or f"{name}_geom{k}"
    lid.pos, lid.quat = np.zeros(3), [1.0, 0.0, 0.0, 0.0]
    frame = spec.body(onto).add_frame(pos=X[:3, 3], quat=quaternion)
    frame.attach_body(lid, "", JOINED)
    for exclude in list(spec.excludes):  # without the body, the model would not compile
        if named & {exclude.bodyname1, exclude.bodyname2}:
            spec.delete(exclude)
    spec.delete(spec.body(name))
    notes = world.notes
    entities = {body: note for body, note in notes.entities.items() if body != name}
    objects = {label: note for label, note in notes.objects.items() if note.body != name}
    overrides = {body: value for body, value in notes.overrides.items() if body != name}
    state = {label: value for label, value in notes.state.items() if label != name and label not in gone}
    allowed = tuple(
        replace(one, **{end: getattr(one, end) + JOINED for end in ("first", "second") if getattr(one, end) in named})
        for one in notes.allowed
    )
    # The keyframes are those of the notes; a spec of other bodies has none any more.
    notes = replace(notes, entities=entities, objects=objects, overrides=overrides, state=state, allowed=allowed)
    return Scene.build(spec, notes)


@per_scene
def _loaded(world: Scene, tray: str, riders: tuple[tuple[str, PoseKey], ...]) -> Scene:
    """Return the scene in which objects are parts of a tray, which is as precious as all of them together."""
    parts = (tray, *(name for name, _ in riders))
    hit = sum(world.entities[name].severity["body"] for name in parts if name in world.entities)
    lost = sum(world.attach(name, X_TO=FROM_ABOVE).own_severity for name in parts)
    scene = world
    for name, slot in riders:
        scene = joined_world(scene, tray, name, slot)
    carried = scene.attach(tray, X_TO=FROM_ABOVE).carried
    assert carried is not None and carried.object_class is not None
    overrides = {**scene.notes.overrides, ITSELF: {carried.object_class: lost}}
    if tray in scene.entities:
        overrides[tray] = {"body": hit}
    return Scene.assemble(scene.posed, replace(scene.notes, overrides=overrides))


@per_scene(most=_KEPT)
def _with_contents(world: Scene, name: str, contents: Contents | None) -> Scene:
    note = world.notes.objects.get(name, ObjectNote(body=name))
    objects = {**world.notes.objects, name: replace(note, contents=contents)}
    return Scene.assemble(world.posed, replace(world.notes, objects=objects))

"""Opening and closing doors and drawers by a handle.

The gripper closes on the handle, the tool follows the path that the joint prescribes, and the gripper opens. While it
holds the handle, the moving part and the objects in it are rigid parts of the hand: they are checked for collisions,
except the part with the rest of its furniture, and count as parts of the robot in harm and in simulations. The force
that moves the part, and a joint that guides it in a failure, are not modelled.

Frames: W world, T tool, L link of the tool, B body of the moving part.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import final

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.frames import pose_matrix
from graceful_plan.exceptions import SettingError
from graceful_plan.job.actions import Action, Deed
from graceful_plan.job.grasping import JOINED, Grasp, handle_grasps
from graceful_plan.job.job_state import JobState, joined_world, pose_key, pose_of
from graceful_plan.job.motions import JobMotion, Motions, Refusal, reversed_motion
from graceful_plan.job.placing import support_of
from graceful_plan.job.tool_paths import JointPath, along_joint
from graceful_plan.path import is_real
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.model_parts import colliding_geoms, find, subtree
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_BACK = 0.08
"""Way of the open gripper from the handle [m], as from an object."""
_POSTURES = 4
"""Configurations at the handle from which its path is followed, until one succeeds."""
_SAMPLED = 8
"""Grasps of the handle that are sampled for each one to choose from, because few reach both ends of its path."""
_THERE = 1e-3
"""Distance of a joint from a position at which it counts as there [rad or m]."""


@dataclass(frozen=True, eq=False)
class _ByHandle(Action):
    """Move a joint of the surroundings by a handle, once in a job."""

    name: str
    handle: str
    to: float | None = None
    grasps: tuple[Grasp, ...] = ()
    required: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "grasps", tuple(self.grasps))
        for grasp in self.grasps:
            if not isinstance(grasp, Grasp):
                raise SettingError("grasps", grasp, "Grasps of the handle")
        if self.to is not None and not (is_real(self.to) and np.isfinite(self.to)):
            raise SettingError("to", self.to, "a position of the joint [rad or m]")

    @property
    def _kind(self) -> str:
        return type(self).__name__.lower()

    @abstractmethod
    def _default(self, low: float, high: float) -> float:
        """Return the position afterwards if none is given [rad or m], from the range of the joint."""

    def check(self, scene: Scene) -> None:
        """Raise an error if the scene has no such joint or handle, or the joint cannot be where it shall."""
        part = _Part.of(scene, self.name)
        if not set(scene.geoms_named(self.handle)) & set(colliding_geoms(scene.model, part.bodies)):
            raise SettingError("handle", self.handle, f"a geom that joint {self.name!r} moves")
        low, high = part.range
        if not low <= self.position(scene) <= high:
            raise SettingError("to", self.to, f"between {low:g} and {high:g}, the range of joint {self.name!r}")
        if not np.isfinite(self.position(scene)):
            raise SettingError("to", self.to, f"a position: joint {self.name!r} has no limits")

    def position(self, scene: Scene) -> float:
        """Return the position of the joint afterwards [rad or m]."""
        return self._default(*_Part.of(scene, self.name).range) if self.to is None else float(self.to)

    def is_due(self, state: JobState) -> bool:
        """Tell whether the joint has to be elsewhere in the end."""
        return self.required and not self.is_there(state)

    def is_there(self, state: JobState) -> bool:
        """Tell whether the joint is where this action moves it."""
        now = _Part.of(state.world, self.name).position
        return abs(now - self.position(state.world)) < _THERE

    def candidates(self, state: JobState, motions: Motions) -> Iterator[Hashable]:
        """Yield grasps of the handle, unless the joint is there or this was done before."""
        if (self._kind, self.name) not in state.facts and not self.is_there(state):
            yield from self._grasps(state, motions)

    def _grasps(self, state: JobState, motions: Motions) -> tuple[Grasp, ...]:
        """Return grasps of the handle that the arm reaches at both ends of its path."""

        def reached() -> tuple[tuple[Grasp, ...], JobState]:
            part, then = _Part.of(state.world, self.name), self.moved(state)
            ends = [(one, one.scene().pose(state.q, part.body)) for one in (state, then)]
            sampled = handle_grasps(state.world, part.body, self.handle, seed=motions.seed)
            given = iter(self.grasps) if self.grasps else islice(sampled, _SAMPLED * motions.n_grasps)
            usable = (
                grasp
                for grasp in given
                if all(
                    len(motions.reached(PoseGoal(grasp.tool_at(X_WB)), one.scene(grasp.opening), motions.q_home))
                    for one, X_WB in ends
                )
            )
            return tuple(islice(usable, motions.n_grasps)), state

        return motions.once(("handle", id(self), *state.surroundings), reached)[0]

    def moved(self, state: JobState) -> JobState:
        """Return the state with the joint elsewhere, and everything in its part."""
        part = _Part.of(state.world, self.name)
        return state.with_joint(self.name, self.position(state.world), _things_in(state, part))

    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        """Go to the handle, hold it, move it along its path, release it."""
        assert isinstance(choice, Grasp)
        key = ("pull", id(self), id(choice), *state.surroundings)
        found = motions.once(key, lambda: (self._pulled(state, choice, motions), state))[0]
        if isinstance(found, Refusal):
            return found
        pulled, then = found
        transit = motions.planned("transit", self.name, state.scene(), state.q, pulled[0].trajectory.q[0])
        if isinstance(transit, Refusal):
            return transit
        pieces = [transit, *pulled]
        after = then.after(pieces[-1].trajectory.q[-1], sum(piece.trajectory.duration for piece in pieces))
        return Deed(steps=[(self._kind, self.name, pieces)], state=after.knowing(self._kind, self.name))

    def _pulled(self, state: JobState, grasp: Grasp, motions: Motions) -> tuple[list[JobMotion], JobState] | Refusal:
        """Return the pieces from the approach to the retreat, and the state with the joint moved."""
        refusal = Refusal(name=self.name, why=f"the arm reaches no grasp of the handle of {self.name!r}")
        then = self.moved(state)
        for follows in _followed(state, _Part.of(state.world, self.name), grasp, self.position(state.world), motions):
            if isinstance(follows, str):
                refusal = Refusal(name=self.name, why=f"the hand cannot follow the handle of {self.name!r}: {follows}")
                continue
            found = self._with_ends(follows, state, then, grasp, motions)
            if not isinstance(found, Refusal):
                return found, then
            refusal = found
        return refusal

    def _with_ends(
        self, pull: Trajectory, state: JobState, then: JobState, grasp: Grasp, motions: Motions
    ) -> list[JobMotion] | Refusal:
        """Verify a motion with the handle, and add those to it and away from it."""
        part, name = _Part.of(state.world, self.name), self.name
        opened, free = state.scene(grasp.opening), then.scene(grasp.opening)
        moved = motions.checked("pull", name, _in_hand(state, part, grasp), pull)
        if isinstance(moved, Refusal):
            return moved
        back = _away("approach", name, opened, pull.q[0], grasp, motions)
        if isinstance(back, Refusal):
            return back
        approach = motions.checked("approach", name, opened, reversed_motion(back.trajectory))
        if isinstance(approach, Refusal):
            return approach
        retreat = _away("retreat", name, free, pull.q[-1], grasp, motions)
        if isinstance(retreat, Refusal):
            return retreat
        grip, release = motions.still("grip", opened, pull.q[0]), motions.still("release", free, pull.q[-1])
        return [approach, grip, moved, release, retreat]


@final
@dataclass(frozen=True, eq=False)
class Open(_ByHandle):
    """Allow to open a door or drawer by its handle, once, so that objects in it come within reach. For `Job.allow`.

    Args:
        name: The joint: a hinge or slide of the surroundings.
        handle: Geom of the handle, or a body that is fixed to the moving part.
        to: Position of the joint afterwards [rad or m]; by default the end of its range farthest from 0.
        grasps: Grasps of the handle, relative to the body that the joint moves; sampled by default.
        required: Whether it has to be there in the end.
    """

    def _default(self, low: float, high: float) -> float:
        return low if abs(low) > abs(high) else high


@final
@dataclass(frozen=True, eq=False)
class Close(_ByHandle):
    """Allow to close a door or drawer by its handle, once. For `Job.allow`.

    Args:
        name: The joint: a hinge or slide of the surroundings.
        handle: Geom of the handle, or a body that is fixed to the moving part.
        to: Position of the joint afterwards [rad or m]; by default that of its range nearest to 0.
        grasps: Grasps of the handle, relative to the body that the joint moves; sampled by default.
        required: Whether it has to be there in the end.
    """

    def _default(self, low: float, high: float) -> float:
        return min(max(0.0, low), high)


def opened_for(body: str, actions: Iterable[object], state: JobState) -> JobState | None:
    """Return the state in which the part of a body is open, by the first action that opens it; None if none does."""
    for action in actions:
        if isinstance(action, Open):
            part = _Part.of(state.world, action.name)
            if body in {part.scene.model.body(b).name for b in part.bodies}:
                return action.moved(state)
    return None


@dataclass(frozen=True, kw_only=True)
class ShutIn:
    """A hinge or slide of the surroundings behind which an object stands: the joint, its body, and its handle.

    `handle` is empty if no geom of the part, or more than one, has a name with "handle".
    """

    joint: str
    body: str
    handle: str

    @property
    def remedy(self) -> str:
        """The action that would help."""
        return f"gp.Open({self.joint!r}, handle={repr(self.handle) if self.handle else '...'})"


def shut_in(state: JobState, name: str, motions: Motions, *, is_reached: bool = False) -> ShutIn | None:
    """Return the joint behind which an object is shut in; None if there is none.

    It moves the part on which the object stands, and is not open. Or else the arm reaches a grasp of the object only
    once it is open; if the arm reaches one behind the closed part, the object is inside of the joint's furniture.
    """
    shut = [one for one in _openings(state) if not one.is_there(state)]
    for one in shut:
        if name in _things_in(state, _Part.of(state.world, one.name)):
            return _shut_in(state, one.name)
    for one in shut:
        if is_reached:
            if _is_inside(state, name, _Part.of(state.world, one.name)):
                return _shut_in(state, one.name)
            continue
        then = one.moved(state)
        here = pose_key(then.pose(name))
        if any(motions.configuration(then, name, grasp, here) is not None for grasp in motions.sampled(then, name)):
            return _shut_in(state, one.name)
    return None


def _is_inside(state: JobState, name: str, part: _Part) -> bool:
    """Tell whether the middle of an object is in the box around the piece of furniture of a part."""
    scene = state.scene()
    model, data = scene.model, scene.data_at(state.q)
    root = int(part.scene.model.body_rootid[part.scene.model.jnt_bodyid[part.joint]])
    geoms = list(colliding_geoms(model, subtree(model, root)))
    R, box = data.geom_xmat[geoms].reshape(-1, 3, 3), model.geom_aabb[geoms]
    middle = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", R, box[:, :3])
    half = np.einsum("gij,gj->gi", np.abs(R), box[:, 3:])
    p_W = data.body(name).xipos
    return bool(((middle - half).min(axis=0) < p_W).all() and (p_W < (middle + half).max(axis=0)).all())


def _openings(state: JobState) -> Iterator[Open]:
    """Yield an action for each limited hinge or slide of the surroundings."""
    model = state.world.model
    for joint in range(model.njnt):
        scalar = int(model.jnt_type[joint]) in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        is_robot = int(model.jnt_bodyid[joint]) in state.world.robot_bodies
        if scalar and not is_robot and model.jnt_limited[joint] and model.joint(joint).name:
            yield Open(model.joint(joint).name, handle="")


def _shut_in(state: JobState, joint: str) -> ShutIn:
    part = _Part.of(state.world, joint)
    names = [part.scene.model.geom(g).name for g in colliding_geoms(part.scene.model, part.bodies)]
    handles = [name for name in names if "handle" in name.lower()]
    return ShutIn(joint=joint, body=part.body, handle=handles[0] if len(handles) == 1 else "")


def _followed(state: JobState, part: _Part, grasp: Grasp, to: float, motions: Motions) -> Iterator[Trajectory | str]:
    """Yield motions of the hand with the handle, or why the arm cannot follow.

    They are sought from configurations at either end, because an arm that can be at one end in many ways may be at the
    other in few.
    """
    held, amount = _in_hand(state, part, grasp), to - part.position
    there = _Part.of(state.with_joint(part.name, to).world, part.name)
    for end, way, is_back in ((part, amount, False), (there, -amount, True)):
        opened = state.with_joint(part.name, to).scene(grasp.opening) if is_back else state.scene(grasp.opening)
        path = end.path(grasp.tool_at(opened.pose(state.q, part.body)), way)
        for q in motions.reached(PoseGoal(path.X_WT), opened, motions.q_home, _POSTURES):
            found = along_joint(q, path, held, speed=motions.speed, seed=motions.seed)
            yield found if isinstance(found, str) or not is_back else reversed_motion(found)


def _away(
    label: str, name: str, scene: Scene, q: Float[Array, " nq"], grasp: Grasp, motions: Motions
) -> JobMotion | Refusal:
    """Move the open gripper straight back from the handle."""
    R_WB = scene.pose(q)[:3, :3] @ grasp.X_TO[:3, :3]
    goal = PoseGoal.from_tool(q, scene, translation=-_BACK * (R_WB @ grasp.approach))
    return motions.straight(label, name, scene, q, goal)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """The part that a joint of the surroundings moves, where it is in a scene."""

    scene: Scene
    joint: int

    @classmethod
    def of(cls, scene: Scene, name: str) -> _Part:
        """Return the part of a joint.

        Raises:
            UnknownNameError: If there is no such joint.
            SettingError: If it belongs to the robot, or is neither a hinge nor a slide.
        """
        joint = find(scene.model, mujoco.mjtObj.mjOBJ_JOINT, "joint of a door or drawer", name)
        kind = int(scene.model.jnt_type[joint])
        scalar = kind in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        if not scalar or int(scene.model.jnt_bodyid[joint]) in scene.robot_bodies:
            raise SettingError("joint", name, "a hinge or slide of the surroundings")
        return cls(scene=scene, joint=joint)

    @property
    def name(self) -> str:
        return self.scene.model.joint(self.joint).name

    @property
    def body(self) -> str:
        return self.scene.model.body(self.scene.model.jnt_bodyid[self.joint]).name

    @cached_property
    def bodies(self) -> frozenset[int]:
        """The body that the joint moves, with everything that is fixed to it."""
        return subtree(self.scene.model, int(self.scene.model.jnt_bodyid[self.joint]))

    @property
    def position(self) -> float:
        return float(self.scene.home_qpos[self.scene.model.jnt_qposadr[self.joint]])

    @property
    def range(self) -> tuple[float, float]:
        model = self.scene.model
        low, high = model.jnt_range[self.joint] if model.jnt_limited[self.joint] else (-np.inf, np.inf)
        return float(low), float(high)

    @property
    def furniture(self) -> list[str]:
        """Names of the other bodies of its piece of furniture."""
        model = self.scene.model
        root = int(model.body_rootid[model.jnt_bodyid[self.joint]])
        return [model.body(b).name for b in sorted(subtree(model, root) - self.bodies) if model.body(b).name]

    def path(self, X_WT: Float[Array, "4 4"], amount: float) -> JointPath:
        """Return the path of a tool that moves with the part."""
        model, data = self.scene.model, self.scene.data_at(self.scene.home_qpos[self.scene.qpos_adr])
        slides = int(model.jnt_type[self.joint]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
        point = None if slides else data.xanchor[self.joint].copy()
        return JointPath(X_WT, data.xaxis[self.joint].copy(), point, amount)


def _things_in(state: JobState, part: _Part) -> tuple[str, ...]:
    """Return the free bodies that stand on a part, or on others that do."""
    scene, model = state.scene(), part.scene.model
    free = [
        model.body(b).name
        for b in range(1, model.nbody)
        if model.body_parentid[b] == 0
        and b not in part.scene.robot_bodies
        and b not in part.bodies
        and model.body_jntnum[b]
        and colliding_geoms(model, subtree(model, b))
    ]
    under = {name: support_of(scene, name) for name in free}
    carriers, found = {model.body(b).name for b in part.bodies}, ()
    while more := tuple(name for name in free if under[name] in carriers and name not in carriers):
        found, carriers = (*found, *more), carriers | set(more)
    return found


def _in_hand(state: JobState, part: _Part, grasp: Grasp) -> Scene:
    """Return the scene in which a part, with the objects in it, is a rigid part of the hand."""
    joined = state
    for name in _things_in(state, part):
        joined = joined.joined(part.body, name)
    model, site = joined.world.model, joined.world.model.site(joined.world.tool)
    R_LT = np.empty(9)
    mujoco.mju_quat2Mat(R_LT, site.quat)
    X_LB = pose_matrix(R_LT, site.pos) @ grasp.X_TO
    link = model.body(int(site.bodyid[0])).name
    fingers = tuple(sorted(grasp.fingers.items())) if isinstance(grasp.fingers, Mapping) else ()
    world = _held_part(joined.world, part.body, link, pose_key(X_LB), tuple(part.furniture), fingers)
    where = {name: X for name, X in joined.where.items() if name != part.body}
    return state.now(world.edit(move={name: pose_of(X) for name, X in where.items()}) if where else world)


@per_scene
def _held_part(
    world: Scene,
    body: str,
    link: str,
    X_LB: tuple[float, ...],
    furniture: tuple[str, ...],
    fingers: tuple[tuple[str, float], ...],
) -> Scene:
    model = world.model
    known = [model.body(b).name for b in sorted(subtree(model, model.body(body).id))]
    moving = [name + JOINED for name in known if name and not name.endswith(JOINED)]
    scene = joined_world(world, link, body, X_LB)
    if fingers:
        scene = scene.with_state(dict(fingers))
    guided = [AllowedContact(one, other, reason="the joint guides it") for one in moving for other in furniture]
    return scene.with_allowed_contacts(*guided) if guided else scene

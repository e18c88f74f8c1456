"""Starts and goals as users give them -> configurations that a planner may use, or the reasons why not.

Misuse (wrong shape, NaN, a name that does not exist) raises; a configuration that is out of limits or in collision is
an outcome, told in words.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError
from graceful_plan.judge.exact import exactly_free, state_contacts
from graceful_plan.path import finite_array
from graceful_plan.query.ik import solve_ik
from graceful_plan.query.whole_body import solve_whole_body
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

Array = np.ndarray
Configuration = ArrayLike | str
"""A configuration [nq] or the name of a keyframe."""
Goal = Configuration | PoseGoal | BasePose | Sequence[Configuration | PoseGoal | BasePose]

_LEVER = 0.25
"""What a radian counts as distance where poses are sorted by how far they are [m/rad]."""
_ENOUGH, _OF_EACH = 8, 2
"""Configurations that are enough for several poses, and for one of them."""
_HEADINGS = 16
"""Of a base where any heading will do."""
CLAMPED = 1e-6
"""How far outside of a position limit [rad or m] a configuration is moved onto it instead of being refused."""
MOST_GOALS = 1000
"""Configurations to plan for: each is the root of a tree."""
_AT_A_TIME = 64
"""Configurations that exact geometry looks at between two looks at the clock."""
_TOLD = 5
"""Configurations of a goal that are told by name why they cannot be used."""


@dataclass(frozen=True, eq=False)
class Resolved:
    """Configurations that may be used, and what happened to the others.

    | field    | meaning                                                        | unit     | shape   |
    |----------|----------------------------------------------------------------|----------|---------|
    | q        | configurations inside the limits and free of collision         | rad or m | usable nq |
    | index    | which of the given configurations each of them is; 0 for poses |          | usable  |
    | notes    | what was adjusted                                              |          |         |
    | problems | why the others cannot be used                                  |          |         |
    """

    q: Float[Array, "usable nq"]
    index: tuple[int, ...]
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def detail(self) -> str:
        """Everything there is to say, in one line."""
        return "; ".join([*self.notes, *self.problems])


def resolve_start(start: Configuration, scene: Scene) -> Resolved:
    """Turn a start into one usable configuration, or none.

    Raises:
        ShapeError: If it does not fit the scene's joints.
        NonFiniteError: If it holds a NaN or an infinity.
        UnknownNameError: If there is no keyframe of that name.
    """
    q = _named(start, scene) if isinstance(start, str) else finite_array("start", start, ndim=1, last=len(scene.joints))
    return _usable("start", q[None], scene, q)


def resolve_goal(
    goal: Goal, scene: Scene, start: ArrayLike, *, seed: int = 0, cancelled: Callable[[], bool] = lambda: False
) -> Resolved:
    """Turn a goal into usable configurations, in the order given; of a pose, those nearest to the start first.

    Of many configurations, those that spheres do not prove free are judged by exact geometry from the nearest on; at
    most `MOST_GOALS` are used, the nearest. Of several poses, inverse kinematics begins with those nearest to where the
    tool is, and stops once there are enough configurations for them.

    Args:
        goal: A configuration, a keyframe by name, a pose of tool or base, or several of these.
        scene: Where.
        start: Where the motion begins; poses are solved near to it.
        seed: Of the random numbers of inverse kinematics.
        cancelled: Ends it early: what was looked at by then is what there is to choose from.

    Raises:
        ShapeError: If it does not fit the scene's joints.
        NonFiniteError: If it holds a NaN or an infinity.
        UnknownNameError: If there is no keyframe of that name.
    """
    if isinstance(goal, PoseGoal):
        return _pose(goal, scene, start, seed, cancelled)
    if isinstance(goal, BasePose):
        return _standing(goal, scene, np.asarray(start, dtype=float))
    several = _poses_among(goal)
    if several:
        return _several(several, scene, start, seed, cancelled)
    q = np.stack(_configurations(cast("Configuration | Sequence[Configuration]", goal), scene))
    begin = np.asarray(start, dtype=float)
    return _usable("goal", _the_short_way(q, begin, scene), scene, begin, over=cancelled)


def has_poses(goal: Goal) -> bool:
    """Whether a goal is a pose, or one of several is."""
    return isinstance(goal, PoseGoal) or bool(_poses_among(goal))


def _poses_among(goal: Goal) -> Sequence[Configuration | PoseGoal | BasePose]:
    """Return several goals if one of them is a pose; else nothing."""
    if isinstance(goal, Sequence) and any(isinstance(one, PoseGoal | BasePose) for one in goal):
        return cast("Sequence[Configuration | PoseGoal | BasePose]", goal)
    return ()


def _standing(goal: BasePose, scene: Scene, start: Float[Array, " nq"]) -> Resolved:
    """Return configurations with the base at a pose and the arm as it is at the start, the nearest heading first.

    Raises:
        SettingError: If the robot has no base that drives.
    """
    if scene.base is None:
        raise SettingError("goal", goal, "a goal of the arm: this robot has no DiffDrive")
    towards = np.arctan2(goal.y - start[1], goal.x - start[0])
    turns = np.arange(_HEADINGS) * 2.0 * np.pi / _HEADINGS
    q = np.tile(start, (1 if goal.yaw is not None else _HEADINGS, 1))
    q[:, 0], q[:, 1], q[:, 2] = goal.x, goal.y, towards + turns if goal.yaw is None else goal.yaw
    q = _the_short_way(q, start, scene)
    q = q[np.argsort(np.abs(q[:, 2] - towards), kind="stable")]
    found = _usable("goal", q, scene, start)
    # Of many headings one that will do is enough.
    return Resolved(found.q, (0,) * len(found.q), found.notes, () if len(found.q) else found.problems[:1])


def poses_of(goal: Goal, index: Sequence[int]) -> tuple[PoseGoal | None, ...]:
    """Return the poses that goals with some indices are; None for those that are configurations."""
    if isinstance(goal, PoseGoal):
        return (goal,) * len(index)
    several = _poses_among(goal)
    chosen = [several[k] if several else None for k in index]
    return tuple(one if isinstance(one, PoseGoal) else None for one in chosen)


def _several(
    goals: Sequence[Configuration | PoseGoal | BasePose],
    scene: Scene,
    start: ArrayLike,
    seed: int,
    cancelled: Callable[[], bool],
) -> Resolved:
    """Resolve configurations, then poses from the nearest on until there is enough."""
    placed = Placement(scene).place(np.asarray(start, dtype=float)).site(scene.tool)
    X_WT = np.eye(4)
    X_WT[:3, :3], X_WT[:3, 3] = placed.xmat.reshape(3, 3), placed.xpos

    def away(k: int) -> float:
        one = goals[k]
        return float(np.dot(pose_error(one, X_WT), (1.0, _LEVER))) if isinstance(one, PoseGoal) else -1.0

    q, index = [np.zeros((0, len(scene.joints)))], []
    notes, problems = [], []
    for k in sorted(range(len(goals)), key=away):
        one = goals[k]
        if isinstance(one, PoseGoal):
            if len(index) >= _ENOUGH or cancelled():
                break
            found = _pose(one, scene, start, seed, cancelled, count=_OF_EACH, rounds=1)
        else:
            found = resolve_goal(one, scene, start)
        q.append(found.q)
        index += [k] * len(found.q)
        notes += [text.replace("goal", f"goal {k}", 1) for text in found.notes]
        problems += [text.replace("goal", f"goal {k}", 1) for text in found.problems]
    return Resolved(np.concatenate(q), tuple(index), tuple(notes), tuple(problems))


def _the_short_way(q: Float[Array, "n nq"], start: Float[Array, " nq"], scene: Scene) -> Float[Array, "n nq"]:
    """Return goals whose joints without limits are turned as near to the start as the range that is planned lets them.

    A configuration outside of the range stays as it is, and is refused as ever.
    """
    lower, upper = scene.limits.position.T
    turned = q - 2.0 * np.pi * np.round((q - start) / (2.0 * np.pi))
    turned = turned + 2.0 * np.pi * ((turned < lower).astype(float) - (turned > upper))
    return np.where(scene.endless & (q >= lower) & (q <= upper), turned, q)


def _configurations(goal: Configuration | Sequence[Configuration], scene: Scene) -> list[Float[Array, " nq"]]:
    nq = len(scene.joints)
    if isinstance(goal, str):
        return [_named(goal, scene)]
    if isinstance(goal, Sequence) and any(isinstance(item, str) for item in goal):
        return [q for item in goal for q in _configurations(item, scene)]  # type: ignore[arg-type]
    q = finite_array("goal", goal, last=nq)  # type: ignore[arg-type]
    if q.ndim > 2 or q.size == 0:
        raise ShapeError("goal", q.shape, f"({nq},) or (n >= 1, {nq})")
    return list(np.atleast_2d(q))


def _named(name: str, scene: Scene) -> Float[Array, " nq"]:
    if name not in scene.keyframes:
        raise UnknownNameError("keyframe", name, scene.keyframes)
    return np.asarray(scene.keyframes[name], dtype=float)


def _usable(
    word: str,
    q: Float[Array, "n nq"],
    scene: Scene,
    start: Float[Array, " nq"],
    over: Callable[[], bool] = lambda: False,
) -> Resolved:
    """Return those within the limits and free of collision, in the order given, and what the others are lacking."""
    words = [word] if len(q) == 1 else [f"{word} {i}" for i in range(len(q))]
    lower, upper = scene.limits.position.T
    inside = np.clip(q, lower, upper)
    excess = np.abs(q - inside).max(axis=1)
    outside = np.flatnonzero(excess > CLAMPED)
    problems = [f"{_beyond(words[i], q[i], scene)}" for i in outside[:_TOLD]]
    notes = [
        f"{_beyond(words[i], q[i], scene)}; moved onto it" for i in np.flatnonzero((excess > 0) & (excess <= CLAMPED))
    ]

    within = np.flatnonzero(excess <= CLAMPED)
    nearest = within[np.argsort(np.linalg.norm(inside[within] - start, axis=1), kind="stable")]
    proved = compile_scene(scene).proof.free(inside[nearest]) if len(nearest) > 1 else np.zeros(len(nearest), bool)
    free, blocked = list(nearest[proved]), []
    open_to_doubt = nearest[~proved]
    for k in range(0, len(open_to_doubt), _AT_A_TIME):
        if k and over():
            problems.append(f"no time to look at {len(open_to_doubt) - k} of {len(q)}")
            break
        some = open_to_doubt[k : k + _AT_A_TIME]
        ok = exactly_free(inside[some], scene)
        free += list(some[ok])
        blocked += list(some[~ok])
    problems += [_collision(words[i], inside[i], scene) for i in blocked[:_TOLD]]
    untold = len(outside[_TOLD:]) + len(blocked[_TOLD:])
    problems += [f"{untold} more of {len(q)} likewise"] if untold else []
    if len(free) > MOST_GOALS:
        notes.append(f"of {len(free)} goals that are free, the {MOST_GOALS} nearest to the start are planned for")
        chosen = set(free)
        free = [i for i in nearest if i in chosen][:MOST_GOALS]
    index = tuple(sorted(int(i) for i in free))
    return Resolved(inside[list(index)], index, tuple(notes), tuple(problems))


def _beyond(word: str, q: Float[Array, " nq"], scene: Scene) -> str:
    """Say which joint is the farthest outside of its limits."""
    lower, upper = scene.limits.position.T
    inside = np.clip(q, lower, upper)
    worst = int(np.argmax(np.abs(q - inside)))
    limit = f"{'lower' if q[worst] < lower[worst] else 'upper'} limit {inside[worst]:.9g}"
    return f"{word}: joint {scene.joints[worst]!r} is at {q[worst]:.9g}, beyond its {limit}"


def _collision(word: str, q: Float[Array, " nq"], scene: Scene) -> str:
    contacts = state_contacts(q, scene)
    if not contacts:
        return ""
    deepest = contacts[0]
    more = f" and {len(contacts) - 1} more" if len(contacts) > 1 else ""
    pair = ", ".join(repr(name.partition("#")[0]) for name in deepest[:2])  # of unnamed geoms their body
    told = f"{word}: {deepest.first} is {1e3 * deepest.depth:.3g} mm in {deepest.second}{more}"
    return f"{told}; if they may touch, say AllowedContact({pair})"


def _pose(
    goal: PoseGoal,
    scene: Scene,
    start: ArrayLike,
    seed: int,
    cancelled: Callable[[], bool],
    **effort: int,
) -> Resolved:
    blocked: list[Array] = []

    def free(q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        ok = exactly_free(q, scene)
        blocked.extend(q[~ok])
        return ok

    if scene.base is not None and len(scene.joints) > len(scene.base.joints):
        begin = np.asarray(start, dtype=float)
        found = solve_whole_body(goal, scene, begin, free=free, seed=seed, cancelled=cancelled)
        if len(found.q):
            return Resolved(found.q, (0,) * len(found.q))
    found = solve_ik(goal, scene, start, free=free, seed=seed, cancelled=cancelled, **effort)
    if len(found.q):
        return Resolved(found.q, (0,) * len(found.q))
    if blocked:
        told = _collision("one", blocked[0], scene)
        problem = f"goal: all {len(blocked)} configurations found for the pose collide; {told}"
    else:
        missing = f"{1e3 * found.position_error:.3g} mm and {found.orientation_error:.3g} rad"
        problem = f"goal: no configuration within the limits reaches the pose; the nearest found misses it by {missing}"
    return Resolved(found.q, (), (), (problem,))

"""The motions of which actions consist, planned once for each pair of ends and state of the world.

A *stance* is a configuration in which the gripper holds an object where it stands, with two straight motions from it:
up with the object, and back without it. Backwards, they lower the object and approach it. Going the same way at the
same times, they have the same accelerations, so they keep the same constraints.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.scene_constraints import default_constraints
from graceful_plan.costs.motion import JointLength
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.job.grasping import Grasp, sampled_grasps
from graceful_plan.job.job_state import JobState, PoseKey, pose_key, pose_of
from graceful_plan.job.nearness import STANDS_FIRST, Nearness, nearness, nearness_at
from graceful_plan.job.placing import occupant
from graceful_plan.job.still_base import is_reached_from, reached_poses, straight_arm_motion
from graceful_plan.judge.exact import Judge, state_contacts
from graceful_plan.judge.verification import verify
from graceful_plan.plan import plan
from graceful_plan.query.candidates.descents import TRACKING_CLEARANCE
from graceful_plan.result import CostBreakdown, PlanResult, PlanStatus
from graceful_plan.scene.loading.naming import lookup
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_LIFTS = (0.08, 0.03)
"""Heights by which an object is lifted before it is carried, the first that is possible [m]."""
_BACK, _SHORT_BACK = 0.08, 0.055
"""Ways of the open gripper from a grasp; the second straight up from objects that are lifted by less [m].

After the shortest lift, the fingers are still beside the object; at a start so near to it, `plan` kept 0.5 mm."""
_STRAIGHT_DOWN = -0.99
"""Vertical component of an approach from which lifting and retreating are the same motion."""
_GRIPPING = 0.5
"""Time in which the gripper opens or closes [s], at rest."""
_TRIED = 32
"""Largest number of sampled grasps of an object that are tried: the arm does not reach all of them."""
_ITERATIONS = 6
"""Iterations of `plan` for a motion of a candidate sequence."""
_AT_MOST = 4000
"""Iterations in which `plan` has to find a first motion, if it finds none with `_ITERATIONS`."""
_SECONDS = 0.08
"""Time limit of `plan` for such a motion if the job has a time limit [s].

With 0.25 s, a search compares a third as many sequences, and the cost after 20 s is 3 % higher on average (12 jobs);
with 0.04 s, it is 13 % higher in one.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class JobMotion:
    """A motion with its scene: the carried object, and the poses of all others.

    `label` is "transit", "approach", "grip", "lift", "carry", "lower", "release", "retreat", "pull", "pour" or
    "wait".
    """

    label: str
    scene: Scene
    trajectory: Trajectory
    cost: CostBreakdown


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """Reason why an action is not possible: the object, a sentence, and the bodies in the way.

    `unsure` says that no motion was found in time, so that there may be one; `by_any_grasp`, that no other grasp helps.
    """

    name: str
    why: str
    blockers: frozenset[str] = frozenset()
    unsure: bool = False
    by_any_grasp: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Stance:
    """A configuration that holds an object where it stands, with the straight motions up and back from it."""

    q: Float[Array, " nq"]
    approach: Trajectory
    lift: Trajectory
    lower: Trajectory
    retreat: Trajectory


@dataclass(eq=False)
class Motions:
    """Plans pieces of motion and caches them.

    Args:
        objective: Objective of all motions.
        movable: Bodies that the job may move.
        supports: Bodies on which each of them may stand, and which it may touch at the ends of a motion.
        given: Grasps of some of them, instead of sampled ones.
        n_grasps: Number of grasps of each that are searched at once; more follow if none of them leads further.
        q_home: Configuration near which stances are sought.
        seed: Seed of all random numbers.
        speed: Fraction of the velocity limits to use.
        limited: Whether motions get little time instead of few iterations.
        left: Time that is left of the job's time limit [s].
        cancelled: As in `plan`.
    """

    objective: Objective
    movable: tuple[str, ...]
    supports: Mapping[str, tuple[str, ...]]
    given: Mapping[str, tuple[Grasp, ...]]
    n_grasps: int
    q_home: Float[Array, " nq"]
    seed: int = 0
    speed: float = 1.0
    limited: bool = False
    left: Callable[[], float] = lambda: np.inf
    cancelled: Callable[[], bool] | None = None
    seconds: dict[str, float] = field(
        default_factory=lambda: {"grasps": 0.0, "plan": 0.0, "stances": 0.0, "checks": 0.0}
    )
    _known: dict[Hashable, object] = field(default_factory=dict)
    _worlds: dict[int, Scene] = field(default_factory=dict)

    def length(self, start: Float[Array, " nq"], goal: Float[Array, " nq"]) -> float:
        """Return a lower bound of the cost of any motion between configurations."""
        return float(np.linalg.norm(goal - start)) if self.objective.motion == JointLength() else 0.0

    def sampled(self, state: JobState, name: str) -> Iterator[Grasp]:
        """Yield the grasps of an object, given or sampled; a lid on it leaves others than before."""
        if own := self.given.get(name):
            yield from own
            return
        key = ("sampled", self._world(state), name)
        if key not in self._known:
            self._known[key] = ([], sampled_grasps(state.world, name, seed=self.seed))
        kept, more = cast("tuple[list[Grasp], Iterator[Grasp]]", self._known[key])
        for k in range(_TRIED):
            if k == len(kept):
                began = time.perf_counter()
                drawn = next(more, None)
                self.seconds["grasps"] += time.perf_counter() - began
                if drawn is None:
                    return
                kept.append(drawn)
            yield kept[k]

    def grasps(self, state: JobState, name: str, to: Sequence[PoseKey]) -> Iterator[Grasp]:
        """Yield the grasps of an object that reach it where it is and at any of some poses, without other things."""
        here = pose_key(state.pose(name))
        for grasp in self.sampled(state, name):
            if self.configuration(state, name, grasp, here) is not None:
                if any(self.configuration(state, name, grasp, X) is not None for X in to):
                    yield grasp

    def _world(self, state: JobState) -> int:
        """Return the id of the world of a state, which is kept alive: keys contain ids."""
        self._worlds[id(state.world)] = state.world
        return id(state.world)

    def reached(self, goal: PoseGoal, scene: Scene, near: Float[Array, " nq"], count: int = 1) -> Float[Array, "n nq"]:
        """Return configurations free of collision that bring the tool to a pose, the nearest first; possibly none."""
        stop = self.cancelled or (lambda: False)
        return reached_poses(goal, scene, near, count=count, seed=self.seed, cancelled=stop)

    def straight(
        self, label: str, name: str, scene: Scene, q: Float[Array, " nq"], goal: PoseGoal
    ) -> JobMotion | Refusal:
        """Plan a straight motion of the tool to a pose."""
        result = straight_arm_motion(q, goal, scene, objective=self.objective, speed=self.speed)
        if result.status is PlanStatus.SOLVED and result.trajectory is not None:
            return JobMotion(label=label, scene=scene, trajectory=result.trajectory, cost=result.cost)
        return Refusal(name=name, why=f"{label} of {name!r}: {result.detail}", blockers=self._blockers(scene, q[None]))

    def once(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the value of a key, made at the first call: for motions that do not depend on where the arm is."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    def configuration(self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey) -> Float[Array, " nq"] | None:
        """Return a configuration that holds an object at a pose, without other things; None if none was found.

        The arm also reaches the ends of the straight motions from there. Where the object is now, the configuration is
        near that at home; elsewhere it is near the one now, so that the arm need not turn around on the way.
        """
        here = pose_key(state.pose(name))
        key = ("ik", self._world(state), name, id(grasp), X_WO, here)
        if key not in self._known:
            now = None if X_WO == here else self.configuration(state, name, grasp, here)
            near = self.q_home if now is None else now
            began = time.perf_counter()
            found = reached_poses(
                PoseGoal(grasp.tool_at(pose_of(X_WO))),
                state.scene(),
                near,
                count=1,
                seed=self.seed,
                within=lambda: self._held_alone(state, name, grasp),
                cancelled=self.cancelled or (lambda: False),
            )
            is_usable = len(found) > 0 and self._leaves(found[0], state, name, grasp, X_WO)
            self._known[key] = found[0] if is_usable else None
            self.seconds["stances"] += time.perf_counter() - began
        return self._known[key]  # type: ignore[return-value]

    def stance(self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey) -> Stance | Refusal:
        """Return the stance of a grasp at a pose, in the absence of everything else that the job may move."""
        key = ("stance", self._world(state), name, id(grasp), X_WO, pose_key(state.pose(name)))
        if key not in self._known:
            q = self.configuration(state, name, grasp, X_WO)
            began = time.perf_counter()
            self._known[key] = (
                Refusal(name=name, why=f"no configuration holds {name!r} there by this grasp")
                if q is None
                else self._made(state, name, grasp, X_WO, q)
            )
            self.seconds["stances"] += time.perf_counter() - began
        return self._known[key]  # type: ignore[return-value]

    def _leaves(self, q: Float[Array, " nq"], state: JobState, name: str, grasp: Grasp, X_WO: PoseKey) -> bool:
        """Tell whether the arm reaches the ends of the straight motions from a configuration that holds an object."""
        held, X_WT = self._held_alone(state, name, grasp), grasp.tool_at(pose_of(X_WO))
        if not any(self._is_reached_from(q, above, state, held) for above in _lifts(X_WT)):
            return False
        away = _away(X_WT, grasp)
        return away is None or self._is_reached_from(q, away, state, self._let_go(state, name, grasp))

    def _is_reached_from(self, q: Float[Array, " nq"], goal: PoseGoal, state: JobState, scene: Scene) -> bool:
        return is_reached_from(q, goal, state.scene(), lambda: scene, seed=self.seed)

    def _held_alone(self, state: JobState, name: str, grasp: Grasp) -> Scene:
        """Return the scene with an object in the gripper, without everything else that the job may move."""
        return self._alone(state, name).holding(name, grasp, self.supports.get(name, ()))

    def _let_go(self, state: JobState, name: str, grasp: Grasp) -> Scene:
        """Return the scene of a retreat, without the object from which the gripper retreats."""
        return self._alone(state, name).parked((name,)).scene(grasp.opening)

    def _made(
        self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey, q: Float[Array, " nq"]
    ) -> Stance | Refusal:
        held, X_WT = self._held_alone(state, name, grasp), grasp.tool_at(pose_of(X_WO))
        up, why, lifts = None, "", _lifts(X_WT)
        for above in lifts:
            if self._is_reached_from(q, above, state, held):
                result = straight_arm_motion(q, above, held, objective=self.objective, speed=self.speed)
                up, why = result.trajectory, result.detail
                if result.status is PlanStatus.SOLVED and up is not None:
                    break
        else:
            return Refusal(name=name, why=f"{name!r} cannot be lifted there by this grasp: {why}")
        away = _away(X_WT, grasp)
        if away is None and above is lifts[0]:
            return _stance(q, up, up)
        opened = self._let_go(state, name, grasp)
        beyond = away or PoseGoal(_shifted(X_WT, np.array([0.0, 0.0, _SHORT_BACK])))
        back = straight_arm_motion(q, beyond, opened, objective=self.objective, speed=self.speed)
        if back.status is not PlanStatus.SOLVED:
            if away is None:
                return _stance(q, up, up)
            return Refusal(name=name, why=f"the gripper cannot leave {name!r} there: {back.detail}")
        return _stance(q, up, back.unwrap())

    def _alone(self, state: JobState, name: str) -> JobState:
        return state.parked(self._others(state, name))

    def _others(self, state: JobState, name: str) -> tuple[str, ...]:
        return tuple(body for body in self.movable if body != name and ("joined", body) not in state.facts)

    def checked(self, label: str, name: str, scene: Scene, trajectory: Trajectory) -> JobMotion | Refusal:
        """Verify and price a given motion in a scene."""
        key = ("checked", id(scene), id(trajectory))
        if key not in self._known:
            began = time.perf_counter()
            verdict = verify(trajectory, scene, constraints=default_constraints(scene))
            if verdict.passed:
                made: JobMotion | Refusal = JobMotion(
                    label=label, scene=scene, trajectory=trajectory, cost=evaluate(trajectory, scene, self.objective)
                )
            else:
                blockers = self._blockers(scene, trajectory.q)
                told = "; ".join(f"{check}: {verdict.checks[check].detail}" for check in verdict.failures)
                made = Refusal(name=name, why=f"{label} of {name!r}: {told}", blockers=blockers)
            self._known[key] = (made, scene, trajectory)  # kept alive: ids are keys
            self.seconds["checks"] += time.perf_counter() - began
        return self._known[key][0]  # type: ignore[index,no-any-return]

    def still(self, label: str, scene: Scene, q: Float[Array, " nq"], seconds: float = _GRIPPING) -> JobMotion:
        """Return a piece at rest."""
        none = np.zeros((2, len(q)))
        trajectory = Trajectory(np.array([0.0, seconds]), np.stack([q, q]), none, none, scene.joints)
        return JobMotion(
            label=label, scene=scene, trajectory=trajectory, cost=evaluate(trajectory, scene, self.objective)
        )

    def planned(
        self, label: str, name: str, scene: Scene, start: Float[Array, " nq"], goal: Float[Array, " nq"]
    ) -> JobMotion | Refusal:
        """Plan a motion between configurations."""
        key = ("planned", id(scene), start.tobytes(), goal.tobytes())
        if key not in self._known:
            began = time.perf_counter()
            result = self._plan(start, goal, scene, self._effort)
            if result.status is PlanStatus.TIMEOUT and self.left() > 0.0:
                more = {"iterations": _AT_MOST, "time_limit": self.left(), "stop": "first"}
                result = self._plan(start, goal, scene, more)
            if result.status is PlanStatus.SOLVED and result.trajectory is not None:
                made: JobMotion | Refusal = JobMotion(
                    label=label, scene=scene, trajectory=result.trajectory, cost=result.cost
                )
            else:
                blockers = self._blockers(scene, np.stack([start, goal]))
                why = f"{label} of {name!r}: {result.status.name}: {result.detail}"
                unsure = result.status in (PlanStatus.TIMEOUT, PlanStatus.CANCELLED)
                made = Refusal(name=name, why=why, blockers=blockers, unsure=unsure)
            self.seconds["plan"] += time.perf_counter() - began
            if isinstance(made, Refusal) and made.unsure and (self.limited or self._is_cancelled):
                return made  # with more time, there may be a motion
            self._known[key] = (made, scene)
        return self._known[key][0]  # type: ignore[index,no-any-return]

    def better(self, motion: JobMotion, seconds: float, iterations: int | None) -> JobMotion:
        """Return a motion with the same ends planned with more effort, if it is better."""
        key = ("better", id(motion))
        if key not in self._known:
            began = time.perf_counter()
            q = motion.trajectory.q
            effort = {"iterations": iterations} if iterations is not None else {"time_limit": seconds}
            result = self._plan(q[0], q[-1], motion.scene, effort, seed=self.seed + 1)
            found = motion
            if result.status is PlanStatus.SOLVED and result.trajectory is not None:
                if result.cost.total < motion.cost.total:
                    found = replace(motion, trajectory=result.trajectory, cost=result.cost)
            self._known[key] = (found, motion)
            self.seconds["plan"] += time.perf_counter() - began
        return self._known[key][0]  # type: ignore[index,no-any-return]

    @property
    def _is_cancelled(self) -> bool:
        return self.cancelled is not None and self.cancelled()

    @property
    def _effort(self) -> dict[str, Any]:
        limit = max(min(_SECONDS, self.left()), 0.02)
        return {"time_limit": limit} if self.limited else {"iterations": _ITERATIONS}

    def _plan(
        self,
        start: Float[Array, " nq"],
        goal: Float[Array, " nq"],
        scene: Scene,
        effort: dict[str, Any],
        seed: int | None = None,
    ) -> PlanResult:
        seed = self.seed if seed is None else seed
        return plan(
            start,
            goal,
            scene,
            objective=self.objective,
            speed=self.speed,
            seed=seed,
            cancelled=self.cancelled,
            **effort,
        )

    def carried(
        self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey
    ) -> tuple[list[JobMotion], list[JobMotion], JobState] | Refusal:
        """Plan to move an object to a pose: the pieces until it is lifted, those after, and the state then."""
        ends = self._ends(state, name, grasp, X_WO)
        if isinstance(ends, Refusal):
            return ends
        # Cheap checks first: straight motions are given, the two others are planned.
        made = self._straight(state, name, grasp, X_WO, ends)
        if isinstance(made, Refusal):
            return made
        first, last = ends
        transit = self.planned("transit", name, state.scene(), state.q, first.retreat.q[-1])
        if isinstance(transit, Refusal):
            return transit
        made["transit"] = transit
        until = sum(made[label].trajectory.duration for label in ("transit", "approach", "grip", "lift"))
        held = state.after(first.lift.q[-1], until).holding(name, grasp, self.supports.get(name, ()))
        carry = self.planned("carry", name, held, first.lift.q[-1], last.lift.q[-1])
        if isinstance(carry, Refusal):
            return carry
        made["carry"] = carry
        before = [made[label] for label in ("transit", "approach", "grip", "lift")]
        after = [made[label] for label in ("carry", "lower", "release", "retreat")]
        seconds = sum(piece.trajectory.duration for piece in (*before, *after))
        return before, after, state.moved(name, pose_of(X_WO)).after(last.retreat.q[-1], seconds)

    def in_time(self, state: JobState, pieces: Iterable[JobMotion]) -> list[JobMotion]:
        """Return pieces with moving entities where they are at the start of each piece, and its cost then.

        Args:
            state: The state in which the first piece begins.
            pieces: Pieces one after the other, in scenes of any time.
        """
        found = []
        for piece in pieces:
            scene = state.timed(piece.scene)
            if scene is not piece.scene:
                cost = evaluate(piece.trajectory, scene, self.objective)
                # The cost of motion may contain the price of a wait.
                piece = replace(piece, scene=scene, cost=replace(cost, motion=piece.cost.motion))
            found.append(piece)
            state = state.after(state.q, piece.trajectory.duration)
        return found

    def unavoidable(
        self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey
    ) -> tuple[float, Float[Array, " nq"]] | Refusal:
        """Return a lower bound of the cost of moving an object to a pose, and the configuration afterwards."""
        ends = self._ends(state, name, grasp, X_WO)
        if isinstance(ends, Refusal):
            return ends
        made = self._straight(state, name, grasp, X_WO, ends)
        if isinstance(made, Refusal):
            return made
        first, last = ends
        lines = self.length(state.q, first.retreat.q[-1]) + self.length(first.lift.q[-1], last.lift.q[-1])
        return sum(piece.cost.total for piece in made.values()) + lines, last.retreat.q[-1]

    def nearness(
        self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey, least: float = 0.0
    ) -> Nearness | Refusal:
        """Return the distances that the straight motions of a transport keep from other things.

        Below `least` [m], the distances may be those at both ends only, which are found in a tenth of the time.
        """
        found = Nearness()
        for _, scene, X in self._touching(state, name, grasp, X_WO):
            if (q := self.configuration(state, name, grasp, X)) is not None:
                found = found.within(nearness_at(q, scene, name, margin=TRACKING_CLEARANCE))
        if found.moving < least:
            return found
        ends = self._ends(state, name, grasp, X_WO)
        made = ends if isinstance(ends, Refusal) else self._straight(state, name, grasp, X_WO, ends)
        if isinstance(made, Refusal):
            return made
        for label in STANDS_FIRST:
            found = found.within(self._nearness(made[label], name))
        return found

    def _nearness(self, piece: JobMotion, name: str) -> Nearness:
        key = ("near", id(piece))
        if key not in self._known:
            began = time.perf_counter()
            first = STANDS_FIRST[piece.label]
            found = nearness(piece.trajectory, piece.scene, name, margin=TRACKING_CLEARANCE, stands_first=first)
            self._known[key] = (found, piece)  # kept alive: ids are keys
            self.seconds["checks"] += time.perf_counter() - began
        return self._known[key][0]  # type: ignore[index,no-any-return]

    def _touching(
        self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey
    ) -> tuple[tuple[str, Scene, PoseKey], ...]:
        """Return the scene of each straight motion of a transport, and where the object stands at one of its ends."""
        here, moved = pose_key(state.pose(name)), state.moved(name, pose_of(X_WO))
        held = state.holding(name, grasp, self.supports.get(name, ()))
        return (
            ("approach", state.scene(grasp.opening), here),
            ("lift", held, here),
            ("lower", held, X_WO),
            ("retreat", moved.scene(grasp.opening), X_WO),
        )

    def _ends(self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey) -> tuple[Stance, Stance] | Refusal:
        """Return the stances where an object is and where it goes, unless the hand collides in one of them."""
        if (other := occupant(state.scene(), name, pose_of(X_WO))) is not None:
            why = f"{name!r}: its place is taken by {other!r}"
            return Refusal(name=name, why=why, blockers=frozenset({other}), by_any_grasp=True)
        for label, scene, X in self._touching(state, name, grasp, X_WO):
            q = self.configuration(state, name, grasp, X)
            # Before the straight motions from there, which take a hundred times as long.
            if q is not None and (contacts := state_contacts(q, scene)):
                mine, _, depth, obstacle = contacts[0]
                why = f"{label} of {name!r}: collision: {mine} is {1e3 * depth:.3g} mm in {obstacle}"
                return Refusal(name=name, why=why, blockers=self._blockers(scene, q[None]))
        first = self.stance(state, name, grasp, pose_key(state.pose(name)))
        if isinstance(first, Refusal):
            return first
        last = self.stance(state, name, grasp, X_WO)
        return last if isinstance(last, Refusal) else (first, last)

    def _straight(
        self, state: JobState, name: str, grasp: Grasp, X_WO: PoseKey, ends: tuple[Stance, Stance]
    ) -> dict[str, JobMotion] | Refusal:
        """Return the motions at both ends of a transport, by label."""
        first, last = ends
        opened, held = state.scene(grasp.opening), state.holding(name, grasp, self.supports.get(name, ()))
        free = state.moved(name, pose_of(X_WO)).scene(grasp.opening)
        made = {}
        for label, scene, trajectory in (
            ("approach", opened, first.approach),
            ("lift", held, first.lift),
            ("lower", held, last.lower),
            ("retreat", free, last.retreat),
        ):
            piece = self.checked(label, name, scene, trajectory)
            if isinstance(piece, Refusal):
                return piece
            made[label] = piece
        made["grip"], made["release"] = self.still("grip", opened, first.q), self.still("release", free, last.q)
        return made

    def _blockers(self, scene: Scene, q: Float[Array, "n nq"]) -> frozenset[str]:
        model = scene.model
        # Lids that were closed are no bodies of their own.
        mine = {name: body for name in self.movable if (body := lookup(model, mujoco.mjtObj.mjOBJ_BODY, name)) >= 0}
        held = scene.carried.body if scene.carried is not None else None
        judge = Judge(scene)
        touches = judge.violations(list(judge.touches(q)), len(q))
        met = {int(model.body_rootid[model.geom_bodyid[g]]) for t in touches for g in (t.first, t.second)}
        return frozenset(name for name, body in mine.items() if body in met and name != held)


def _lifts(X_WT: Float[Array, "4 4"]) -> list[PoseGoal]:
    """Return the tool poses to which an object may be lifted from one, the most wanted first."""
    return [PoseGoal(_shifted(X_WT, np.array([0.0, 0.0, height]))) for height in _LIFTS]


def _away(X_WT: Float[Array, "4 4"], grasp: Grasp) -> PoseGoal | None:
    """Return where the open gripper retreats from a grasp; None if straight up, as it lifts."""
    way = X_WT[:3, :3] @ np.asarray(grasp.X_TO)[:3, :3] @ np.asarray(grasp.approach)
    return None if way[2] < _STRAIGHT_DOWN else PoseGoal(_shifted(X_WT, -_BACK * way))


def _shifted(X: Float[Array, "4 4"], by: Float[Array, " xyz"]) -> Float[Array, "4 4"]:
    X = X.copy()
    X[:3, 3] += by
    return X


def _stance(q: Float[Array, " nq"], lift: Trajectory, back: Trajectory) -> Stance:
    return Stance(q=q, approach=reversed_motion(back), lift=lift, lower=reversed_motion(lift), retreat=back)


def reversed_motion(motion: Trajectory) -> Trajectory:
    """Return a motion backwards."""
    return Trajectory(motion.t[-1] - motion.t[::-1], motion.q[::-1], -motion.qd[::-1], motion.qdd[::-1], motion.joints)


def added(costs: Iterable[CostBreakdown], w: float) -> CostBreakdown:
    """Return the sum of costs."""
    motion = impact = 0.0
    entities: dict[str, float] = {}
    components: dict[str, float] = {}
    for cost in costs:
        motion, impact = motion + cost.motion, impact + cost.impact
        for total, part in ((entities, cost.impact_by_entity), (components, cost.impact_by_component)):
            for name, value in part.items():
                total[name] = total.get(name, 0.0) + value
    return CostBreakdown(motion=motion, impact=impact, w=w, impact_by_entity=entities, impact_by_component=components)

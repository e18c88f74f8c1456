"""Actions of a job: their preconditions, choices, motions and effects.

An own action is a class with the two methods `candidates` and `motion` (and `bound`, if it has one); pass an instance
to `Job.allow`. Preconditions are checked in `candidates`; effects are the state that `motion` returns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, groupby, islice
from typing import ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.job.grasping import Grasp
from graceful_plan.job.job_state import SAME, JobState, PoseKey, pose_key, pose_of
from graceful_plan.job.motions import JobMotion, Motions, Refusal
from graceful_plan.path import is_real
from graceful_plan.query.candidates.descents import TRACKING_CLEARANCE
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_FARTHER = 0.002
"""Distance by which a choice has to keep farther from other things to replace one that keeps too little [m]."""
_ROUNDS = 2
"""Number of grasps among which such a choice is sought, in multiples of those that are searched at once."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Deed:
    """One or more named stretches of motion and the state after them.

    Args:
        steps: Name, object and pieces of each stretch, such as ("pick", "vase", [...]).
        state: The state of the world afterwards.
    """

    steps: Sequence[tuple[str, str, Sequence[JobMotion]]]
    state: JobState


@dataclass(frozen=True, kw_only=True, eq=False)
class Outlook:
    """What is known of an action without planning it: a lower bound of its cost, and the state afterwards."""

    cost: float
    state: JobState


class Action(ABC):
    """Something that a job may do."""

    name: str
    """The object that it is about."""
    kind: str = ""
    """Its name in lists of actions, such as "place"; if empty, the name of the class in lower case."""

    @property
    def moves(self) -> tuple[str, ...]:
        """Objects that it lifts; none by default. They may touch their supports at the ends of a motion."""
        return ()

    @abstractmethod
    def candidates(self, state: JobState, motions: Motions) -> Iterator[Hashable]:
        """Yield the choices with which the action is possible in a state, as far as that is known without planning.

        Args:
            state: The state.
            motions: Plans and caches motions.
        """

    def groups(self, state: JobState, motions: Motions) -> Iterator[Sequence[Hashable]]:
        """Yield the candidates in groups with the same grasp, by default as they follow each other.

        Override it if finding the first candidate of a group takes time: the default looks one candidate ahead.
        """
        for _, group in groupby(self.candidates(state, motions), key=_grasp_of):
            yield list(group)

    @abstractmethod
    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        """Plan the action; return its motions and the state afterwards, or why it is not possible."""

    def bound(self, state: JobState, choice: Hashable, motions: Motions) -> float:
        """Return a lower bound of the cost; 0 by default."""
        return 0.0

    def is_due(self, state: JobState) -> bool:
        """Tell whether the job cannot end in a state because this action has to come first; False by default."""
        return False

    def check(self, scene: Scene) -> None:
        """Raise an error if the action does not fit the scene of a job; `Job.allow` calls it."""
        return

    def outlook(self, state: JobState, choice: Hashable, motions: Motions) -> Outlook | Refusal | None:
        """Return a bound of the cost and the state afterwards without planning, or why it is not possible.

        None, by default, if that is not known; the lower bound of a job then counts no harm.
        """
        return None


@dataclass(frozen=True)
class Carry:
    """A choice of a transport: the grasp and the pose to which the object goes."""

    grasp: Grasp
    to: PoseKey

    def __hash__(self) -> int:
        return hash((id(self.grasp), self.to))


def _grasp_of(choice: Hashable) -> int | None:
    grasp = choice.grasp if isinstance(choice, Carry) else choice
    return id(grasp) if isinstance(grasp, Grasp) else None


@final
@dataclass(frozen=True, eq=False)
class Transport(Action):
    """Carry an object from where it stands to a given pose, or to any of several, with the objects in its slots.

    Args:
        name: The object.
        to: Poses to choose from.
        kind: Name of the second step: "place", "clear", "close_lid", "load" or "carry".
        onto: Body to which the poses are relative, and which may move during the job; None for poses in W.
        slots: Pose of each object that may stand on this one and is carried with it, relative to it.
    """

    name: str
    to: tuple[PoseKey, ...]
    kind: str = "place"
    onto: str | None = None
    slots: Mapping[str, PoseKey] = field(default_factory=dict)

    def poses(self, state: JobState) -> tuple[PoseKey, ...]:
        """Return the poses in W."""
        if self.onto is None:
            return self.to
        X_WB = state.pose(self.onto)
        return tuple(pose_key(X_WB @ pose_of(X)) for X in self.to)

    def is_done(self, state: JobState) -> bool:
        """Tell whether the object stands at any of the poses."""
        if ("joined", self.name) in state.facts:
            return False
        here = state.pose(self.name)
        return any(np.allclose(here, pose_of(X), atol=SAME) for X in self.poses(state))

    def candidates(self, state: JobState, motions: Motions) -> Iterator[Carry]:
        """Yield grasps that reach the object where it is and at any of the poses."""
        return chain.from_iterable(self.groups(state, motions))

    def groups(self, state: JobState, motions: Motions) -> Iterator[Sequence[Carry]]:
        """Yield the candidates of each grasp, without a look at the next grasp."""
        if ("joined", self.name) in state.facts or self.is_done(state):
            return
        now, here = state.loaded(self.name, self.slots), pose_key(state.pose(self.name))
        to = [X for X in self.poses(state) if X != here]
        for grasp in motions.grasps(now, self.name, to):
            yield [Carry(grasp, X) for X in to if motions.configuration(now, self.name, grasp, X) is not None]

    def bound(self, state: JobState, choice: Hashable, motions: Motions) -> float:
        """Return the length of straight motions in joint space to the object and on to its place."""
        first, last = self.ends(state, choice, motions)
        return motions.length(state.q, first) + motions.length(first, last)

    def ends(self, state: JobState, choice: Hashable, motions: Motions) -> tuple[Array, Array]:
        """Return the configurations that hold the object where it is and at its place."""
        assert isinstance(choice, Carry)
        now, here = state.loaded(self.name, self.slots), pose_key(state.pose(self.name))
        both = [motions.configuration(now, self.name, choice.grasp, X) for X in (here, choice.to)]
        assert both[0] is not None and both[1] is not None
        return both[0], both[1]

    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        """Pick the object up, carry it, put it down."""
        assert isinstance(choice, Carry)
        if (farther := self._farther(state, choice, motions)) is not None:
            return farther
        found = motions.carried(state.loaded(self.name, self.slots), self.name, choice.grasp, choice.to)
        if isinstance(found, Refusal):
            return found
        before, after, then = found
        arrived = self._arrived(state, choice.to).after(then.q, then.clock - state.clock)
        return Deed(steps=[("pick", self.name, before), (self.kind, self.name, after)], state=arrived)

    def _farther(self, state: JobState, choice: Carry, motions: Motions) -> Refusal | None:
        """Refuse a choice that comes close to other things if another one is possible and keeps farther away."""
        now = state.loaded(self.name, self.slots)
        kept, nearest = self._kept(now, choice, motions, TRACKING_CLEARANCE)
        if not 0.0 < kept < TRACKING_CLEARANCE:  # of a choice that collides, the reason is told elsewhere
            return None
        wanted = min(kept + _FARTHER, TRACKING_CLEARANCE)
        for group in islice(self.groups(state, motions), _ROUNDS * motions.n_grasps):
            for other in group:
                if other.grasp is choice.grasp and other.to == choice.to:
                    continue
                has, _ = self._kept(now, other, motions, wanted)
                if has >= wanted and not isinstance(motions.carried(now, self.name, other.grasp, other.to), Refusal):
                    told = f"it comes within {1e3 * kept:.2g} mm of {nearest!r}, and another choice keeps farther away"
                    return Refusal(name=self.name, why=f"{self.name!r}: {told}")
        return None

    def _kept(self, now: JobState, choice: Carry, motions: Motions, least: float) -> tuple[float, str]:
        """Return the distance that a choice keeps from other things, and the nearest; 0 if it is not possible."""
        found = motions.nearness(now, self.name, choice.grasp, choice.to, least)
        if isinstance(found, Refusal):
            return 0.0, ""
        # Where the object may stand in one place only, nothing else can be chosen.
        standing = found.standing if len(self.to) > 1 else np.inf
        return min((found.moving, found.passed), (standing, found.beside))

    def outlook(self, state: JobState, choice: Hashable, motions: Motions) -> Outlook | Refusal | None:
        """Return the cost of the straight motions at both ends and of straight lines in joint space between them."""
        assert isinstance(choice, Carry)
        if state.world.moving:
            return None  # harm depends on the time
        found = motions.unavoidable(state.loaded(self.name, self.slots), self.name, choice.grasp, choice.to)
        if isinstance(found, Refusal):
            return found
        cost, q = found
        return Outlook(cost=cost, state=self._arrived(state, choice.to).after(q, 0.0))

    def _arrived(self, state: JobState, X_WO: PoseKey) -> JobState:
        """Return the state with the object at a pose, with everything on it."""
        arrived, X_WT = state.moved(self.name, pose_of(X_WO)), pose_of(X_WO)
        for rider in state.on(self.name, self.slots):
            arrived = arrived.moved(rider, X_WT @ pose_of(self.slots[rider]))
        return arrived


class _ByTransport(Action):
    """An action whose motions are those of a transport."""

    @abstractmethod
    def _transport(self, state: JobState) -> Transport:
        """Return the transport in a state."""

    @abstractmethod
    def _is_open(self, state: JobState) -> bool:
        """Tell whether the action may come in a state."""

    def candidates(self, state: JobState, motions: Motions) -> Iterator[Hashable]:
        """Yield the candidates of the transport, if the action may come."""
        return chain.from_iterable(self.groups(state, motions))

    def groups(self, state: JobState, motions: Motions) -> Iterator[Sequence[Hashable]]:
        """Yield those of each grasp."""
        if self._is_open(state):
            yield from self._transport(state).groups(state, motions)

    def bound(self, state: JobState, choice: Hashable, motions: Motions) -> float:
        """Return the bound of the transport."""
        return self._transport(state).bound(state, choice, motions)

    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        """Carry the object."""
        return self._transport(state).motion(state, choice, motions)

    def outlook(self, state: JobState, choice: Hashable, motions: Motions) -> Outlook | Refusal | None:
        """Return the outlook of the transport."""
        return self._transport(state).outlook(state, choice, motions)


@final
@dataclass(frozen=True)
class Clear:
    """Allow to put an object elsewhere: out of the way of others, or for another grasp. For `Job.allow`.

    Args:
        name: The object.
        on: Body on which it may be put; by default the one on which it stands.
        in_region: Region as in `placements`, instead of all of the body.
        n: Number of placements to choose from.
    """

    name: str
    on: str | None = None
    in_region: ArrayLike | None = None
    n: int = 4


@final
@dataclass(frozen=True)
class CloseLid:
    """Allow to put a lid on a vessel; its contents then stay inside, and the lid is carried with it. For `Job.allow`.

    Args:
        vessel: The vessel.
        lid: The lid, a separate object.
        X_VL: Pose of the lid on the vessel; by default upright, centred on top of it.
    """

    vessel: str
    lid: str
    X_VL: ArrayLike | None = None


@final
@dataclass(frozen=True)
class Load:
    """Allow to put goal objects on a tray, and to carry the tray with them. For `Job.allow`.

    Only objects without contents are put on it: a spill from a tray is not modelled.

    Args:
        name: The tray: an object with a horizontal top, and a handle or rim by which the gripper holds it.
        on: Body on which it may be put down; not needed if the tray has a goal of its own.
        in_region: Region as in `placements`, instead of all of the body.
        n: Number of placements to choose from.
    """

    name: str
    on: str | None = None
    in_region: ArrayLike | None = None
    n: int = 4


@final
@dataclass(frozen=True, eq=False)
class Loading(_ByTransport):
    """Put an object on a tray, unless it has arrived at its goal or the tray has been carried already."""

    name: str
    tray: str
    slot: PoseKey
    start: PoseKey
    """Pose of the tray before it is carried."""
    goals: Sequence[Transport]
    kind: str = field(default="load", init=False)

    def _transport(self, state: JobState) -> Transport:
        return Transport(self.name, (self.slot,), self.kind, self.tray)

    def _is_open(self, state: JobState) -> bool:
        arrived = any(goal.name == self.name and goal.is_done(state) for goal in self.goals)
        return not arrived and pose_key(state.pose(self.tray)) == self.start


@final
@dataclass(frozen=True, eq=False)
class Hauling(_ByTransport):
    """Carry a tray with something on it, once."""

    name: str
    to: tuple[PoseKey, ...]
    slots: Mapping[str, PoseKey]
    start: PoseKey
    """Pose of the tray before it is carried."""
    kind: str = field(default="carry", init=False)

    def _transport(self, state: JobState) -> Transport:
        return Transport(self.name, self.to, self.kind, slots=self.slots)

    def _is_open(self, state: JobState) -> bool:
        return pose_key(state.pose(self.name)) == self.start and bool(state.on(self.name, self.slots))


@final
@dataclass(frozen=True, eq=False)
class Clearing(_ByTransport):
    """Put an object out of the way, unless it has arrived at its goal or was put away before.

    Args:
        name: The object.
        to: Poses to choose from.
        goals: Transports to goals.
    """

    name: str
    to: tuple[PoseKey, ...]
    goals: Sequence[Transport]
    kind: str = field(default="clear", init=False)

    def _transport(self, state: JobState) -> Transport:
        return Transport(self.name, self.to, self.kind)

    def _is_open(self, state: JobState) -> bool:
        return not any(goal.name == self.name and goal.is_done(state) for goal in self.goals)


@final
@dataclass(frozen=True, eq=False)
class Closing(_ByTransport):
    """Put a lid on a vessel where it stands."""

    name: str
    vessel: str
    X_VL: Float[Array, "4 4"]
    kind: str = field(default="close_lid", init=False)

    def _transport(self, state: JobState) -> Transport:
        return Transport(self.name, (pose_key(state.pose(self.vessel) @ self.X_VL),), self.kind)

    def _is_open(self, state: JobState) -> bool:
        return ("joined", self.name) not in state.facts

    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        """Carry the lid to the vessel; both are one object afterwards."""
        deed = super().motion(state, choice, motions)
        return deed if isinstance(deed, Refusal) else replace(deed, state=self._closed(deed.state))

    def outlook(self, state: JobState, choice: Hashable, motions: Motions) -> Outlook | Refusal | None:
        """Return the outlook of carrying the lid to the vessel."""
        ahead = super().outlook(state, choice, motions)
        return replace(ahead, state=self._closed(ahead.state)) if isinstance(ahead, Outlook) else ahead

    def _closed(self, state: JobState) -> JobState:
        """Return the state in which lid and vessel are one object."""
        return state.joined(self.vessel, self.name).with_contents(self.vessel, None).knowing("joined", self.name)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Wait(Action):
    """Allow to wait until a moving entity has passed. For `Job.allow`.

    Args:
        max_seconds: Longest wait at a time [s].
        price: Cost of a second of waiting [1/s], which counts as motion cost. The default is a tenth of the motion cost
            of an arm at about 2 rad/s.
    """

    max_seconds: float
    price: float = 0.2
    name: str = "wait"
    STEPS: ClassVar[int] = 4
    """Number of waits to choose from, evenly spaced."""

    def __post_init__(self) -> None:
        if not (is_real(self.max_seconds) and 0.0 < self.max_seconds < np.inf):
            raise SettingError("max_seconds", self.max_seconds, "a finite number above 0 [s]")
        if not (is_real(self.price) and 0.0 <= self.price < np.inf):
            raise SettingError("price", self.price, "a finite number of at least 0 [1/s]")

    def candidates(self, state: JobState, motions: Motions) -> Iterator[float]:
        """Yield durations, if an entity still moves and the last action was no wait."""
        if state.is_moving and ("waited", str(state.clock)) not in state.facts:
            yield from (self.max_seconds * (k + 1) / self.STEPS for k in range(self.STEPS))

    def bound(self, state: JobState, choice: Hashable, motions: Motions) -> float:
        """Return the price of the wait."""
        assert isinstance(choice, float)
        return self.price * choice

    def motion(self, state: JobState, choice: Hashable, motions: Motions) -> Deed | Refusal:
        """Stay at rest."""
        assert isinstance(choice, float)
        piece = motions.still("wait", state.scene(), state.q, choice)
        cost = replace(piece.cost, motion=piece.cost.motion + self.price * choice)
        piece = replace(piece, cost=cost)
        then = state.after(state.q, choice)
        return Deed(steps=[("wait", self.name, [piece])], state=then.knowing("waited", str(then.clock)))

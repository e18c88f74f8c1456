"""Search over sequences of actions: anytime, lazy, best first, with dives.

A node is a state of the world with the cost of reaching it; an edge is an action with a choice, such as a grasp and a
placement. Edges are planned only when they are the best left. They are ordered by an estimate, see
`sequence_estimate.py`. Of the choices of an action in a node, one at a time is open, so all orders are tried before all
grasps. An edge is discarded once its lower bound shows that it cannot lead to a cheaper sequence.

If all choices of a goal are refused because of objects that were moved before, it is blocked by them where they are
now. Nodes with these objects there, and this goal still to be met, are dead ends; they come after all other nodes.

Until the first sequence is complete, the deepest node comes first, and actions that meet a goal come before all others.
Grasps are drawn one by one until then. Later, the best edge is followed down to a complete sequence as long as its
estimate is below the least known cost. If all choices of an action in a node are refused, more grasps are drawn.

References:
    C. Dellin and S. Srinivasa, "A Unifying Formalism for Shortest Path Problems with Expensive Edge Evaluations via
    Lazy Best-First Search over Paths with Edge Selectors", ICAPS 2016.
    M. Likhachev et al., "ARA*: Anytime A* with Provable Bounds on Sub-Optimality", NeurIPS 2003: first a quick
    solution, then better ones with a bound.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

from graceful_plan.job.actions import Action, Carry, Clearing, Closing, Deed, Hauling, Loading, Transport, Wait
from graceful_plan.job.job_state import JobState, PoseKey, pose_key
from graceful_plan.job.motions import JobMotion, Motions, Refusal, added
from graceful_plan.job.rejected import Actions, SearchRecord
from graceful_plan.job.sequence_estimate import KnownCosts
from graceful_plan.result import CostBreakdown

_TIME_PRICE = 1e-3
"""Price of time [1/s], so that of sequences with equal costs the shortest one is chosen: waiting costs nothing else."""
_FAR = 1e6
"""More than any cost, so that edges are ordered by depth first."""
_ENDANGERED = 0.01
"""Share of harm to moving entities in the cost of an action from which waiting before it is tried."""
_DEAD_END = 1e9
"""Far more than `_FAR` times any depth, so that edges into dead ends come last."""
_CHEAP = 5
"""Number of actions that are refused without planning, in about the time that a planned one takes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Node:
    """A state with the deeds that lead to it and their total cost."""

    state: JobState
    deeds: tuple[Deed, ...] = ()
    cost: float = 0.0
    actions: Actions = ()


@dataclass(kw_only=True, eq=False)
class Alternatives:
    """The choices of an action in the state of a node."""

    groups: Iterator[Sequence[Hashable]]
    """Choices that are not drawn yet, by grasp; those without a grasp all at once."""
    owed: int
    """Number of grasps that are to be drawn at least."""
    waiting: list[Edge] = field(default_factory=list)
    """Edges that are drawn and not open yet."""
    is_possible: bool = False
    """Whether one of them was planned."""
    needs_grasp: bool = False
    """Whether one was refused that may be possible by another grasp."""
    drawn: int = 0
    """Number of choices that are drawn."""
    refused: int = 0
    """Number of them that are refused without planning, counted by `instead`."""
    obstacles: set[tuple[str, PoseKey]] = field(default_factory=set)
    """Objects that were moved before and are in the way of refused choices, with their poses."""
    may_become_free: bool = False
    """Whether the obstacles of one of them may still be moved, or more time may help."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Edge:
    """An action that is possible in the state of a node, not planned yet; `bound` bounds its cost."""

    node: Node
    action: Action
    choice: Hashable
    bound: float
    others: Alternatives

    @property
    def actions(self) -> Actions:
        """The actions up to this one, as kinds and objects."""
        action = self.action
        return (*self.node.actions, (action.kind or type(action).__name__.lower(), action.name))

    @property
    def where(self) -> set[tuple[str, PoseKey]]:
        """The poses of moved objects after the action, as far as they are known."""
        where = dict(self.node.state.where)
        if isinstance(self.choice, Carry):
            where[self.action.name] = self.choice.to
        return set(where.items())


@dataclass(eq=False)
class SequenceSearch:
    """A search for the cheapest sequence of actions after which all goals are met.

    Args:
        start: State at the start.
        goals: Transports whose objects must have arrived in the end.
        actions: All actions.
        motions: Plans and caches motions.
        order: Names of goal objects in the order in which they must be placed; empty for any order.
    """

    start: JobState
    goals: Sequence[Transport]
    actions: Sequence[Action]
    motions: Motions
    order: tuple[str, ...] = ()
    best: Node | None = None
    complete: list[Node] = field(default_factory=list)
    """Nodes of all complete sequences that were found."""
    tried: int = 0
    """Number of actions for which motions were planned."""
    refused: int = 0
    """Number of actions that were refused without that, and of waits."""
    refusals: dict[str, Refusal] = field(default_factory=dict)
    record: SearchRecord = field(default_factory=SearchRecord)
    """What became of each alternative."""
    exhausted: bool = False
    """Whether no edges are left."""
    unsure: bool = False
    """Whether a motion was not found in time, so that there may be more sequences."""
    _open: list[tuple[float, int, Edge]] = field(default_factory=list)
    _followed: set[int] = field(default_factory=set)
    """Ids of open edges that were planned in a dive."""
    _known: KnownCosts = field(default_factory=KnownCosts)
    _waited: dict[int, Node] = field(default_factory=dict)
    """Nodes by id in which waits are tried."""
    _rests: dict[Hashable, Mapping[str, float]] = field(default_factory=dict)
    """Lower bounds of carrying each missing object, by state."""
    _blocked: dict[str, list[set[tuple[str, PoseKey]]]] = field(default_factory=dict)
    """Sets of moved objects with their poses that block each goal."""
    _number: int = 0

    def run(self, over: Callable[[int], bool], improved: Callable[[Node], None] = lambda _: None) -> None:
        """Search until all sequences are compared, or `over` returns True, given the number of planned edges."""
        seen: dict[object, float] = {}
        reached = self._expand(Node(state=self.start), seen, improved)
        while len(self._open) > len(self._followed):
            if over(self.planned):  # before the estimates of the next edge, which may take time
                return
            edge = self._next(reached)
            node = None
            if self._may_pay(edge):
                node = self.child(edge)
                edge.others.is_possible = edge.others.is_possible or node is not None
            else:
                self.record.bounded(edge.actions, self.least(edge))
            opened = self._open_next(edge)
            if node is None:  # the dive goes on from the same node
                reached = [*(other for other in reached if other is not edge), *opened] if edge in reached else []
            else:
                if waits := self._waits(edge.node, node):
                    self._start(edge.node, waits)
                reached = self._expand(node, seen, improved)
        self._open.clear()
        self.exhausted = True

    def _may_pay(self, edge: Edge) -> bool:
        """Tell whether an edge may lead to a cheaper sequence."""
        return self.best is None or self.least(edge) < self.best.cost

    def _next(self, reached: Sequence[Edge]) -> Edge:
        """Return the edge to plan next: the best of the node last reached if it is promising, or of all."""
        if self.best is not None and reached:
            rank, edge = min(((self._rank(edge), edge) for edge in reached), key=lambda pair: pair[0])
            if rank < self.best.cost:
                self._followed.add(id(edge))
                return edge
        while True:
            known, _, edge = heapq.heappop(self._open)
            if id(edge) in self._followed:
                self._followed.discard(id(edge))
                continue
            # Ranks mostly grow as costs and dead ends become known.
            if self._open and self._rank(edge) > max(known, self._open[0][0]):
                self._push(edge)
                continue
            return edge

    @property
    def planned(self) -> int:
        """Number of planned actions, to which refused ones and waits count by the time that they take."""
        return self.tried + self.refused // _CHEAP

    @property
    def lower_bound(self) -> float:
        """The least cost that a sequence over the choices at hand can have."""
        left = (edge for _, _, first in self._open for edge in (first, *first.others.waiting))
        # The bounds of choices that are not drawn yet are unknown.
        least = min((self.least(edge) - edge.bound * (edge.others.owed > 0) for edge in left), default=float("inf"))
        return least if self.best is None else min(least, self.best.cost)

    def open_edges(self) -> Iterator[tuple[Edge, float]]:
        """Yield edges that were not planned, with a lower bound of the cost of all sequences with each."""
        planned = set(self._followed)
        for _, _, first in self._open:
            if id(first) in planned:
                planned.discard(id(first))
                continue
            for edge in (first, *first.others.waiting):
                known = edge.node.state.key in self._rests  # to find it may take long
                yield edge, self.least(edge) if known else edge.node.cost + edge.bound

    def least(self, edge: Edge) -> float:
        """Return a lower bound of the cost of all sequences with an edge, over the choices that are drawn first."""
        return edge.node.cost + edge.bound + self.remaining(edge.node, but=edge.action.name)

    def remaining(self, node: Node, *, but: str = "") -> float:
        """Return a lower bound of carrying all objects to their goals, but one."""
        return sum(least for name, least in self._missing(node).items() if name != but)

    def instead(self, edge: Edge, refusal: Refusal) -> Sequence[Edge]:
        """Return the edges of further grasps if the last of the alternatives of an edge is refused."""
        others = edge.others
        others.refused, others.needs_grasp = others.refused + 1, others.needs_grasp or not refusal.by_any_grasp
        if others.refused < others.drawn or not others.needs_grasp:
            return []
        return self._drawn(edge.node, edge.action, others, self.motions.n_grasps)

    def child(self, edge: Edge) -> Node | None:
        """Plan an edge; return the node that it leads to, or None if the action is not possible."""
        deed = edge.action.motion(edge.node.state, edge.choice, self.motions)
        is_cheap = isinstance(edge.action, Wait) or (isinstance(deed, Refusal) and not deed.unsure)
        self.tried, self.refused = self.tried + (not is_cheap), self.refused + is_cheap
        if isinstance(deed, Refusal):
            edge.others.needs_grasp = edge.others.needs_grasp or not deed.by_any_grasp
            self.refusals[deed.name] = deed
            self.unsure = self.unsure or deed.unsure
            self.record.refused(edge.actions, deed, edge.node.cost + edge.bound)
            self._note_obstacles(edge, deed)
            return None
        deed = self._in_time(edge.node.state, deed)
        pieces = [piece for _, _, some in deed.steps for piece in some]
        seconds = sum(piece.trajectory.duration for piece in pieces)
        cost = added([piece.cost for piece in pieces], self.motions.objective.w).total + _TIME_PRICE * seconds
        self._learn(edge, pieces, cost)
        return Node(state=deed.state, deeds=(*edge.node.deeds, deed), cost=edge.node.cost + cost, actions=edge.actions)

    def _note_obstacles(self, edge: Edge, refusal: Refusal) -> None:
        """Note which moved objects are in the way of an edge."""
        where, others = edge.node.state.where, edge.others
        moved = {(name, where[name]) for name in refusal.blockers if name in where}
        others.obstacles |= moved
        if refusal.unsure or (refusal.blockers and not moved):
            others.may_become_free = True

    def _learn_dead_end(self, edge: Edge) -> None:
        """Remember what blocks a goal of which all choices are refused."""
        others = edge.others
        if edge.action in self.goals and others.obstacles and not (others.is_possible or others.may_become_free):
            known = self._blocked.setdefault(edge.action.name, [])
            if others.obstacles not in known:
                known.append(others.obstacles)

    def _dead_ends(self, edge: Edge) -> int:
        """Return the number of goals that are known to be blocked after an edge and still to be met."""
        if not self._blocked:
            return 0
        state, where = edge.node.state, edge.where
        return sum(
            any(obstacles <= where for obstacles in self._blocked.get(goal.name, ()))
            for goal in self.goals
            if goal is not edge.action and not goal.is_done(state)
        )

    def _in_time(self, state: JobState, deed: Deed) -> Deed:
        """Return a deed with moving entities where they are at the start of each of its pieces."""
        steps = []
        for kind, name, pieces in deed.steps:
            steps.append((kind, name, self.motions.in_time(state, pieces)))
            state = state.after(state.q, sum(piece.trajectory.duration for piece in pieces))
        return replace(deed, steps=steps)

    def _learn(self, edge: Edge, pieces: Sequence[JobMotion], cost: float) -> None:
        """Remember what the estimates of other edges need."""
        state, name, w = edge.node.state, edge.action.name, self.motions.objective.w
        others = (other for other in self.motions.movable if other != name)
        impact = {other: sum(piece.cost.impact_by_entity.get(other, 0.0) for piece in pieces) for other in others}
        self._known.learn(
            name,
            keys=(self._memory(edge), self._protection(state)),
            bound=edge.bound,
            cost=cost,
            motion=sum(piece.cost.motion for piece in pieces),
            harm={(other, other in state.where): w * value for other, value in impact.items()},
        )

    def edges(self, node: Node, actions: Sequence[Action] | None = None) -> Iterator[Edge]:
        """Yield the actions, by default all, that are possible in the state of a node."""
        for some in self._alternatives(node, self.actions if actions is None else actions, self.motions.n_grasps):
            yield from some

    def _alternatives(self, node: Node, actions: Sequence[Action], grasps: int) -> Iterator[Sequence[Edge]]:
        """Yield the edges of each action, with a number of grasps."""
        for action in actions:
            if not self._in_order(node.state, action):
                continue
            others = Alternatives(groups=action.groups(node.state, self.motions), owed=self.motions.n_grasps)
            yield self._drawn(node, action, others, grasps)

    def _drawn(self, node: Node, action: Action, others: Alternatives, grasps: int) -> Sequence[Edge]:
        """Return the edges of the next choices."""
        groups = list(islice(others.groups, grasps))
        others.owed = max(others.owed - grasps, 0) if len(groups) == grasps else 0
        others.drawn += sum(len(group) for group in groups)
        return [
            Edge(
                node=node,
                action=action,
                choice=choice,
                bound=action.bound(node.state, choice, self.motions),
                others=others,
            )
            for group in groups
            for choice in group
        ]

    def is_complete(self, state: JobState) -> bool:
        """Tell whether all goals are met and no action is due."""
        met = all(goal.is_done(state) for goal in self.goals)
        return met and not any(action.is_due(state) for action in self.actions)

    def _expand(self, node: Node, seen: dict[object, float], improved: Callable[[Node], None]) -> Sequence[Edge]:
        """Open edges of a node unless its state was reached at less cost; return the edges."""
        is_complete = self.is_complete(node.state)
        is_new = node.cost < seen.get(node.state.key, float("inf"))
        self.record.reached(
            node.actions, deeds_cost(node.deeds, self.motions.objective.w), is_complete=is_complete, is_new=is_new
        )
        if not is_new:
            return []
        seen[node.state.key] = node.cost
        if is_complete:
            self.complete.append(node)
            if self.best is None or node.cost < self.best.cost:
                first = self.best is None
                self.best = node
                if first:  # from now on the most promising edge comes first, not the deepest
                    # Estimates take time, so these are made when an edge is due.
                    self._open = [(edge.node.cost + edge.bound, k, edge) for _, k, edge in self._open]
                    heapq.heapify(self._open)
                improved(node)
            return []
        return self._start(node, [action for action in self.actions if not isinstance(action, Wait)])

    def _start(self, node: Node, actions: Sequence[Action]) -> Sequence[Edge]:
        """Open an edge of each action that is possible in a node; return the edges."""
        opened = []
        grasps = 1 if self.best is None else self.motions.n_grasps
        for some in self._alternatives(node, actions, grasps):
            if some:
                opened.append(self._opened(some))
        return opened

    def _opened(self, edges: Sequence[Edge]) -> Edge:
        """Open the most promising of some alternatives; the others wait."""
        best = min(edges, key=self._estimate)
        best.others.waiting = [edge for edge in edges if edge is not best]
        self._push(best)
        return best

    def _open_next(self, edge: Edge) -> Sequence[Edge]:
        """Open the next alternative of a planned or discarded edge; return it, or nothing."""
        others, edges = edge.others, edge.others.waiting
        if others.owed and (self.best is not None or not edges):
            grasps = others.owed if self.best is not None else 1
            edges = [*edges, *self._drawn(edge.node, edge.action, others, grasps)]
        elif others.needs_grasp and not (edges or others.is_possible) and self._may_pay(edge):
            edges = self._drawn(edge.node, edge.action, others, self.motions.n_grasps)
        if not edges:
            self._learn_dead_end(edge)
            return []
        return [self._opened(edges)]

    def _waits(self, node: Node, child: Node) -> Sequence[Wait]:
        """Return waits before an action that endangers moving entities, once for each node.

        A wait before an action that endangers none is no better than the same wait after it.
        """
        waits = [action for action in self.actions if isinstance(action, Wait)]
        if waits and id(node) not in self._waited:
            pieces = [piece for _, _, some in child.deeds[-1].steps for piece in some]
            harm = sum(
                piece.cost.impact_by_entity.get(name, 0.0) for piece in pieces for name in node.state.world.moving
            )
            if self.motions.objective.w * harm > _ENDANGERED * (child.cost - node.cost):
                self._waited[id(node)] = node
                return waits
        return []

    def _push(self, edge: Edge) -> None:
        self._number += 1
        heapq.heappush(self._open, (self._rank(edge), self._number, edge))

    def _rank(self, edge: Edge) -> float:
        """Return a number by which open edges are ordered, the least first."""
        ahead = 0.0 if self.best is not None else _FAR * (2 * len(edge.node.deeds) + (edge.action in self.goals))
        return self._estimate(edge) - ahead + _DEAD_END * self._dead_ends(edge)

    def _in_order(self, state: JobState, action: Action) -> bool:
        if action.name not in self.order or not any(action is goal for goal in self.goals):
            return True
        earlier = self.order[: self.order.index(action.name)]
        return all(goal.is_done(state) for goal in self.goals if goal.name in earlier)

    def _missing(self, node: Node) -> Mapping[str, float]:
        """Return a lower bound of carrying each object that is not at its goal yet; found when it is first needed."""
        state = node.state
        if state.key in self._rests:
            return self._rests[state.key]
        found = {}
        for goal in self.goals:
            if goal.is_done(state):
                continue
            if self._is_changeable(goal):
                found[goal.name] = 0.0  # a tray, for example, may bring both close together
            else:
                groups = islice(goal.groups(state, self.motions), self.motions.n_grasps)
                ends = (goal.ends(state, choice, self.motions) for group in groups for choice in group)
                # Without a candidate, it may be possible after a regrasp.
                found[goal.name] = min((self.motions.length(*pair) for pair in ends), default=0.0)
        self._rests[state.key] = found
        return found

    def _is_changeable(self, goal: Transport) -> bool:
        """Tell whether another action may move an object or its goal, or change how it is reached."""
        if goal.onto is not None or goal.slots:
            return True
        for action in self.actions:
            if action is goal or isinstance(action, Wait):
                continue
            is_known = isinstance(action, Transport | Loading | Hauling | Clearing | Closing)
            is_vessel = isinstance(action, Closing) and action.vessel == goal.name
            if not is_known or action.name == goal.name or is_vessel:
                return True
        return False

    def _estimate(self, edge: Edge) -> float:
        # What closes a lid, for example, may free the motions that follow of all harm.
        is_usual = edge.action in self.goals or isinstance(edge.action, Wait | Clearing)
        state, name, known = edge.node.state, edge.action.name, self._known
        protection = self._protection(state)
        elsewhere = {other: other in state.where for other in self.motions.movable}
        own = known.cost(name, (self._memory(edge), protection), edge.bound, elsewhere)
        # Until a sequence is complete, only edges of equal depth are compared.
        missing = {} if self.best is None else dict(self._missing(edge.node))
        missing.pop(name, None)
        if is_usual:
            rest = known.rest(missing, protection, {**elsewhere, name: True})
        else:
            rest = sum(known.motion(other, least) for other, least in missing.items())
        return edge.node.cost + own + rest

    def _protection(self, state: JobState) -> Hashable:
        """Return a key of what changes the harm of all motions, such as the lids that were closed."""
        return id(state.world), frozenset(fact for fact in state.facts if fact[0] != "waited")

    def _memory(self, edge: Edge) -> Hashable:
        """Return what edges of about the same cost share: the object, the grasp, from where to where, protection."""
        if not isinstance(edge.choice, Carry):
            return id(edge.action), edge.choice
        here, protection = pose_key(edge.node.state.pose(edge.action.name)), self._protection(edge.node.state)
        return edge.action.name, id(edge.choice.grasp), here, edge.choice.to, protection


def deeds_cost(deeds: Sequence[Deed], w: float) -> CostBreakdown:
    """Return the total cost of some deeds."""
    return added([piece.cost for deed in deeds for _, _, pieces in deed.steps for piece in pieces], w)

"""Search over sequences of actions: anytime, lazy, best first.

A node is a state of the world with the cost of reaching it; an edge is an action with a choice, such as a grasp and a
placement. Edges are planned only when they are the best left. They are ordered by an estimate: the known cost of
carrying the same object between the same places, or else their lower bound times the mean ratio of costs to bounds.
Each remaining object adds its least known cost with the same protection, such as closed lids, or else its least known
motion cost. An edge is discarded once its lower bound shows that it cannot lead to a cheaper sequence. Until the first
sequence is complete, the deepest node comes first, and actions that meet a goal come before all others.

References:
    C. Dellin and S. Srinivasa, "A Unifying Formalism for Shortest Path Problems with Expensive Edge Evaluations via
    Lazy Best-First Search over Paths with Edge Selectors", ICAPS 2016.
    M. Likhachev et al., "ARA*: Anytime A* with Provable Bounds on Sub-Optimality", NeurIPS 2003: first a quick
    solution, then better ones with a bound.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from graceful_plan.job.actions import Action, Carry, Deed, Loading, Transport, Wait
from graceful_plan.job.job_state import JobState, pose_key
from graceful_plan.job.motions import Motions, Refusal, added

_TIME_PRICE = 1e-3
"""Price of time [1/s], so that of sequences with equal costs the shortest one is chosen: waiting costs nothing else."""
_FAR = 1e6
"""More than any cost, so that edges are ordered by depth first."""
_ENDANGERED = 0.01
"""Share of harm to moving entities in the cost of an action from which waiting before it is tried."""
_RATIO = 2.0
"""Ratio of cost to lower bound that is assumed before any edge is planned."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Node:
    """A state with the deeds that lead to it and their total cost."""

    state: JobState
    deeds: tuple[Deed, ...] = ()
    cost: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Edge:
    """An action that is possible in the state of a node, not planned yet.

    `bound` bounds its cost, and `missing` that of carrying each other object to its goal.
    """

    node: Node
    action: Action
    choice: Hashable
    bound: float
    missing: Mapping[str, float]

    @property
    def least(self) -> float:
        """Lower bound of the cost of all sequences with this edge."""
        return self.node.cost + self.bound + sum(self.missing.values())


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
    planned: int = 0
    refusals: dict[str, Refusal] = field(default_factory=dict)
    exhausted: bool = False
    """Whether no edges are left."""
    unsure: bool = False
    """Whether a motion was not found in time, so that there may be more sequences."""
    _open: list[tuple[float, int, Edge]] = field(default_factory=list)
    _carried: dict[Hashable, float] = field(default_factory=dict)
    _cheapest: dict[Hashable, float] = field(default_factory=dict)
    """Least cost of each goal object's transports that were planned, by protection; least motion cost for None."""
    _ratios: list[float] = field(default_factory=list)
    _waited: dict[int, Node] = field(default_factory=dict)
    """Nodes by id in which waits are tried."""
    _number: int = 0

    def run(self, over: Callable[[int], bool], improved: Callable[[Node], None] = lambda _: None) -> None:
        """Search until all sequences are compared, or `over` returns True, given the number of planned edges."""
        seen: dict[object, float] = {}
        self._expand(Node(state=self.start), seen, improved)
        while self._open:
            if over(self.planned):
                return
            _, _, edge = heapq.heappop(self._open)
            if self.best is not None and edge.least >= self.best.cost:
                continue
            node = self.child(edge)
            if node is not None:
                self._push(self._waits(edge.node, node))
                self._expand(node, seen, improved)
        self.exhausted = True

    @property
    def lower_bound(self) -> float:
        """The least cost that a sequence over the choices at hand can have."""
        least = min((edge.least for _, _, edge in self._open), default=float("inf"))
        return least if self.best is None else min(least, self.best.cost)

    def child(self, edge: Edge) -> Node | None:
        """Plan an edge; return the node that it leads to, or None if the action is not possible."""
        self.planned += not isinstance(edge.action, Wait)  # which needs no planning
        deed = edge.action.motion(edge.node.state, edge.choice, self.motions)
        if isinstance(deed, Refusal):
            self.refusals[deed.name] = deed
            self.unsure = self.unsure or deed.unsure
            return None
        pieces = [piece for _, _, some in deed.steps for piece in some]
        seconds = sum(piece.trajectory.duration for piece in pieces)
        cost = added([piece.cost for piece in pieces], self.motions.objective.w).total + _TIME_PRICE * seconds
        transit = sum(piece.cost.total for piece in pieces if piece.label == "transit")
        self._carried[self._memory(edge)] = cost - transit
        if edge.action in self.goals:
            name, motion = edge.action.name, sum(piece.cost.motion for piece in pieces)
            for known, value in (((name, self._protection(edge.node.state)), cost), ((name, None), motion)):
                self._cheapest[known] = min(value, self._cheapest.get(known, np.inf))
        if edge.bound > 0.0:
            self._ratios.append(cost / edge.bound)
        return Node(state=deed.state, deeds=(*edge.node.deeds, deed), cost=edge.node.cost + cost)

    def edges(self, node: Node, actions: Sequence[Action] | None = None) -> Iterator[Edge]:
        """Yield the actions, by default all, that are possible in the state of a node."""
        missing = self._missing(node.state)
        for action in self.actions if actions is None else actions:
            if not self._in_order(node.state, action):
                continue
            rest = {name: least for name, least in missing.items() if name != action.name}
            for choice in action.candidates(node.state, self.motions):
                bound = action.bound(node.state, choice, self.motions)
                yield Edge(node=node, action=action, choice=choice, bound=bound, missing=rest)

    def is_complete(self, state: JobState) -> bool:
        """Tell whether all goals are met and no action is due."""
        met = all(goal.is_done(state) for goal in self.goals)
        return met and not any(action.is_due(state) for action in self.actions)

    def _expand(self, node: Node, seen: dict[object, float], improved: Callable[[Node], None]) -> None:
        if node.cost >= seen.get(node.state.key, float("inf")):
            return
        seen[node.state.key] = node.cost
        if self.is_complete(node.state):
            self.complete.append(node)
            if self.best is None or node.cost < self.best.cost:
                first = self.best is None
                self.best = node
                if first:  # from now on the most promising edge comes first, not the deepest
                    self._open = [(self._estimate(edge), k, edge) for _, k, edge in self._open]
                    heapq.heapify(self._open)
                improved(node)
            return
        self._push(self.edges(node, [action for action in self.actions if not isinstance(action, Wait)]))

    def _waits(self, node: Node, child: Node) -> Iterator[Edge]:
        """Yield waits before an action that endangers moving entities, once for each node.

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
                yield from self.edges(node, waits)

    def _push(self, edges: Iterator[Edge]) -> None:
        for edge in edges:
            self._number += 1
            ahead = 0.0 if self.best is not None else _FAR * (2 * len(edge.node.deeds) + (edge.action in self.goals))
            heapq.heappush(self._open, (self._estimate(edge) - ahead, self._number, edge))

    def _in_order(self, state: JobState, action: Action) -> bool:
        if action.name not in self.order or not any(action is goal for goal in self.goals):
            return True
        earlier = self.order[: self.order.index(action.name)]
        return all(goal.is_done(state) for goal in self.goals if goal.name in earlier)

    def _missing(self, state: JobState) -> dict[str, float]:
        """Return a lower bound of carrying each object that is not at its goal yet."""
        found = {}
        for goal in self.goals:
            if goal.is_done(state):
                continue
            by_tray = any(isinstance(action, Loading) and action.name == goal.name for action in self.actions)
            if by_tray or goal.onto is not None or goal.slots:
                found[goal.name] = 0.0  # a tray may bring both close together, and has other grasps when it is loaded
            else:
                ends = (goal.ends(state, choice, self.motions) for choice in goal.candidates(state, self.motions))
                # Without a candidate, it may be possible after a regrasp.
                found[goal.name] = min((self.motions.length(*pair) for pair in ends), default=0.0)
        return found

    def _estimate(self, edge: Edge) -> float:
        ratio = sum(self._ratios) / len(self._ratios) if self._ratios else _RATIO
        known = self._carried.get(self._memory(edge))
        # What clears the way, or closes a lid, may free the motions that follow of all harm.
        is_usual = edge.action in self.goals or isinstance(edge.action, Wait)
        protection = self._protection(edge.node.state) if is_usual else None
        rest = 0.0
        for name, least in edge.missing.items():
            motion = self._cheapest.get((name, None), ratio * least)
            rest += self._cheapest.get((name, protection), motion)
        return edge.node.cost + (ratio * edge.bound if known is None else known) + rest

    def _protection(self, state: JobState) -> Hashable:
        """Return a key of the bodies that were cleared and the lids that were closed."""
        goals = {goal.name for goal in self.goals}
        cleared = tuple(sorted((name, X) for name, X in state.where.items() if name not in goals))
        return id(state.world), cleared, frozenset(fact for fact in state.facts if fact[0] != "waited")

    def _memory(self, edge: Edge) -> Hashable:
        """Return what edges of about the same cost share: the object, the grasp, from where to where, protection."""
        if not isinstance(edge.choice, Carry):
            return id(edge.action), edge.choice
        here, protection = pose_key(edge.node.state.pose(edge.action.name)), self._protection(edge.node.state)
        return edge.action.name, id(edge.choice.grasp), here, edge.choice.to, protection

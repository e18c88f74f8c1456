"""Connection of new configurations to the tree of RRT*: lazy, and in batches of edges.

The cost of an edge is an integral over the states along it, a hundred times as expensive as the state costs at its
ends. So candidate parents are ranked by estimated cost, and are checked and evaluated in this order until no other
candidate can be cheaper. All new configurations of a batch are processed together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.planners.interruptible import InterruptibleProblem, checked_costs
from graceful_plan.planners.trees.star_tree import StarTree

_PROBES = 64
_TINY = 1e-300


@final
@dataclass(frozen=True)
class EdgeGuess:
    """Estimates the cost of an edge without evaluating it.

    Args:
        bound: Lower bound of the cost per length; 0 if it is unknown.
        motion: Mean motion cost per length.
        impact: Mean cost of the impact per length, relative to the mean of the state costs at both ends.
        trust: Weight of the estimate in `least`, as opposed to the lower bound. With 0, no edge is skipped that could
            be better; with 0.5 (and no lower bound), an edge is skipped if half of its estimated cost is too much.
    """

    bound: float
    motion: float
    impact: float
    trust: float

    @classmethod
    def learn(cls, questions: InterruptibleProblem, *, bound: float, reach: float, trust: float) -> EdgeGuess:
        """Fit the estimates to random edges of up to `reach` [rad] within the limits.

        Raises:
            CostError: If the objective returns a NaN, an infinity or a negative number.
        """
        problem, objective = questions.problem, questions.objective
        rng = np.random.default_rng(0)  # the same probes in every call; independent of the planner's random numbers
        q0, towards = rng.uniform(problem.lower, problem.upper, (2, _PROBES, len(problem.start)))
        q1 = q0 + min(1.0, reach / max(problem.extent, _TINY)) * rng.uniform(size=(_PROBES, 1)) * (towards - q0)
        length = np.linalg.norm(q1 - q0, axis=1)
        cost = checked_costs(objective, "edge costs", np.asarray(objective.edges(q0, q1), dtype=np.float64))
        ends = 0.5 * (questions.state_costs(q0) + questions.state_costs(q1))
        return cls(
            bound=bound,
            motion=float(cost[:, 0].sum() / max(length.sum(), _TINY)),
            impact=float(objective.w * cost[:, 1].sum() / max(float((ends * length).sum()), _TINY)),
            trust=trust,
        )

    def expected(self, length: Float[Array, "..."], impact: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the estimated cost of edges from their lengths and the mean state costs of their ends."""
        return (self.motion + self.impact * impact) * length

    def least(self, length: Float[Array, "..."], expected: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the cost below which edges are assumed not to be; see `trust`."""
        return (1.0 - self.trust) * self.bound * length + self.trust * expected


@final
@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges between each of n configurations and c nodes; `free` is 1 or 0, or -1 if it is unknown."""

    node: Int[Array, "n c"]
    own: Bool[Array, "n c"]
    """False for duplicates of a node."""
    expected: Float[Array, "n c"]
    least: Float[Array, "n c"]
    free: Int[Array, "n c"]

    def __getitem__(self, rows: Int[Array, " m"]) -> _Edges:
        return _Edges(self.node[rows], self.own[rows], self.expected[rows], self.least[rows], self.free[rows])


@final
class TreeConnector:
    """Connects configurations to a tree.

    Args:
        tree: The tree.
        questions: Access to problem and objective.
        guess: Estimates of edge costs.
        bounded: Whether to skip configurations that cannot be on a path cheaper than the best one.
    """

    def __init__(self, tree: StarTree, questions: InterruptibleProblem, guess: EdgeGuess, bounded: bool) -> None:
        self.tree, self.questions, self.guess, self.bounded = tree, questions, guess, bounded

    def join(
        self, q: Float[Array, "n nq"], near: Int[Array, " n"], k: int, way: Int[Array, " vertex"]
    ) -> Int[Array, " m"]:
        """Add the configurations that can be reached, and rewire other nodes to them where that is cheaper.

        Args:
            q: New configurations.
            near: For each, a node with a free edge to it.
            k: Number of nearest nodes that are candidates for parents and for rewiring; the parents of these nodes and
                the goals are candidates, too.
            way: Further candidates: nodes of the best path.

        Returns:
            The new nodes.

        Raises:
            Interrupted: If the time is over.
            CostError: If the objective violates its contract.
        """
        if len(q) == 0:
            return np.zeros(0, dtype=int)
        impact = self.questions.state_costs(q)
        edges = self._edges(q, impact, near, k, way)
        parent, step = self._cheapest(q, edges)
        kept = np.flatnonzero(np.isfinite(step))
        new = self.tree.add(q[kept], parent[kept], step[kept], impact[kept])
        self._rewire(new, edges[kept])
        return new

    def _edges(self, q: Array, impact: Array, near: Array, k: int, way: Array) -> _Edges:
        tree, n = self.tree, len(q)
        close = tree.neighbours(q, k)
        shared = np.broadcast_to(np.concatenate([tree.goals, way]), (n, len(tree.goals) + len(way)))
        node = np.sort(
            np.concatenate([near[:, None], close, np.maximum(0, tree.parent[close]), shared], axis=1), axis=1
        )
        own = np.diff(node, axis=1, prepend=-1) > 0
        length = np.linalg.norm(tree.q[node] - q[:, None], axis=2)
        expected = self.guess.expected(length, 0.5 * (tree.impact[node] + impact[:, None]))
        free = np.where(node == near[:, None], 1, -1)
        return _Edges(node, own, expected, self.guess.least(length, expected), free)

    def _cheapest(self, q: Array, edges: _Edges) -> tuple[Int[Array, " n"], Float[Array, " n"]]:
        """Return the cheapest parent of each configuration and the cost of its edge; infinite if there is no parent."""
        come = np.where(edges.own, self.tree.cost[edges.node], np.inf)
        order = np.argsort(come + edges.expected, axis=1)
        least = np.take_along_axis(come + edges.least, order, axis=1)
        best, parent, step = self._limits(q), np.full(len(q), -1), np.full(len(q), np.inf)
        place = np.arange(order.shape[1])
        turn = np.zeros(len(q), dtype=int)  # index in `order` of the first candidate that is not evaluated
        while True:
            worth = (least < best[:, None]) & (place >= turn[:, None])
            row = np.flatnonzero(worth.any(axis=1))
            if len(row) == 0:
                return parent, step
            turn[row] = worth[row].argmax(axis=1) + 1
            column = order[row, turn[row] - 1]
            free = self._are_free(edges, row, column, q)
            row, column = row[free], column[free]
            node = edges.node[row, column]
            cost = self.questions.edge_costs(self.tree.q[node], q[row])
            better = self.tree.cost[node] + cost < best[row]
            row, node, cost = row[better], node[better], cost[better]
            best[row], parent[row], step[row] = self.tree.cost[node] + cost, node, cost

    def _rewire(self, new: Int[Array, " n"], edges: _Edges) -> None:
        """Make new nodes the parents of other nodes where that is cheaper."""
        tree = self.tree
        limit = np.minimum(tree.cost[edges.node], self._limits(tree.q[edges.node.ravel()]).reshape(edges.node.shape))
        worth = edges.own & (tree.cost[new][:, None] + edges.least < limit) & (edges.node != tree.parent[new][:, None])
        row, column = np.nonzero(worth)
        free = self._are_free(edges, row, column, tree.q[new])
        row, column = row[free], column[free]
        node, over = edges.node[row, column], new[row]
        step = self.questions.edge_costs(tree.q[over], tree.q[node])
        for i in np.argsort(tree.cost[over] + step, kind="stable"):
            tree.lead(int(node[i]), int(over[i]), float(step[i]))

    def _are_free(self, edges: _Edges, row: Array, column: Array, q: Array) -> Bool[Array, " n"]:
        """Return which edges are free; no edge is checked twice, in either direction."""
        ask = edges.free[row, column] < 0
        node = edges.node[row[ask], column[ask]]
        edges.free[row[ask], column[ask]] = self.questions.edges_free(self.tree.q[node], q[row[ask]])
        return edges.free[row, column] == 1

    def _limits(self, q: Array) -> Float[Array, " n"]:
        """Return the cost that a path to each configuration has to stay below."""
        best = self.tree.cost[self.tree.goals].min() if self.bounded else np.inf
        if np.isinf(best) or self.guess.bound == 0.0:
            return np.full(len(q), best)
        goals = self.tree.q[self.tree.goals]
        return best - self.guess.bound * np.linalg.norm(q[:, None] - goals, axis=2).min(axis=1)

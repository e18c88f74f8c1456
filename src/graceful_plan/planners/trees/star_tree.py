"""The tree of RRT*: nodes with parents, children and costs."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int

_FIRST_CAPACITY = 1024
_NEGLIGIBLE = 1e-9
"""Relative gain below which a lower cost is rounding, which could make a node a descendant of itself."""


@final
class StarTree:
    """Nodes in the order of insertion, each with its cheapest-known path from the root.

    Node 0 is the root. The next nodes are the goals; their cost is infinite until the tree reaches them.

    Args:
        root: Root configuration.
        goals: Goal configurations.
        impact: State cost of the root and of each goal.
    """

    def __init__(
        self, root: Float[Array, " nq"], goals: Float[Array, "goal nq"], impact: Float[Array, " node"]
    ) -> None:
        self._q = np.zeros((_FIRST_CAPACITY, len(root)))
        self._cost, self._impact = np.zeros((2, _FIRST_CAPACITY))
        self._parent = np.zeros(_FIRST_CAPACITY, dtype=int)
        self._children: list[list[int]] = []
        self._n = 0
        self.goals = np.arange(1, 1 + len(goals))
        """Nodes that are goals."""
        ends = np.concatenate([root[None], goals])
        self._append(ends, np.r_[0.0, np.full(len(goals), np.inf)], impact)

    def __len__(self) -> int:
        return self._n

    @property
    def q(self) -> Float[Array, "node nq"]:
        """All configurations."""
        return self._q[: self._n]

    @property
    def cost(self) -> Float[Array, " node"]:
        """Cost of the path from the root to each node."""
        return self._cost[: self._n]

    @property
    def impact(self) -> Float[Array, " node"]:
        """State cost of each node."""
        return self._impact[: self._n]

    @property
    def parent(self) -> Int[Array, " node"]:
        """Parent of each node; -1 for the root and for goals that are not reached."""
        return self._parent[: self._n]

    def add(
        self,
        q: Float[Array, "n nq"],
        parent: Int[Array, " n"],
        step: Float[Array, " n"],
        impact: Float[Array, " n"],
    ) -> Int[Array, " n"]:
        """Append nodes, each reached from its parent by an edge of cost `step`; return their indices."""
        nodes = self._append(q, self.cost[parent] + step, impact)
        self._parent[nodes] = parent
        for node, before in zip(nodes.tolist(), parent.tolist(), strict=True):
            self._children[before].append(node)
        return nodes

    def lead(self, node: int, parent: int, step: float) -> bool:
        """Change the parent of a node, with an edge of cost `step`, if that is cheaper; return whether it is."""
        cost = float(self._cost[parent] + step)
        gain = float(self._cost[node]) - cost
        if not cost < self._cost[node] * (1.0 - _NEGLIGIBLE):
            return False
        if self._parent[node] >= 0:
            self._children[self._parent[node]].remove(node)
        followers = list(self._children[node])
        for follower in followers:  # the list grows during the loop
            followers += self._children[follower]
        self._cost[followers] -= gain
        self._cost[node] = cost
        self._parent[node] = parent
        self._children[parent].append(node)
        return True

    def squares(self, q: Float[Array, "n nq"]) -> Float[Array, "n node"]:
        """Return squared distances of configurations from all nodes, up to rounding."""
        nodes = self.q
        ends = np.einsum("ij,ij->i", q, q)[:, None] + np.einsum("ij,ij->i", nodes, nodes)
        return ends - 2.0 * q @ nodes.T

    def nearest(self, q: Float[Array, "n nq"]) -> Int[Array, " n"]:
        """Return the nearest reached node of each configuration."""
        return np.where(np.isfinite(self.cost), self.squares(q), np.inf).argmin(axis=1)

    def neighbours(self, q: Float[Array, "n nq"], k: int) -> Int[Array, "n k"]:
        """Return the k nearest nodes of each configuration in any order; all nodes if there are fewer."""
        if k >= self._n:
            return np.broadcast_to(np.arange(self._n), (len(q), self._n))
        return np.argpartition(self.squares(q), k - 1, axis=1)[:, :k]

    def branch(self, node: int) -> Int[Array, " node"]:
        """Return the nodes from the root to a reached node."""
        nodes = [node]
        while nodes[-1] > 0:
            nodes.append(int(self._parent[nodes[-1]]))
        return np.array(nodes[::-1])

    def _append(self, q: Array, cost: Array, impact: Array) -> Int[Array, " n"]:
        while self._n + len(q) > len(self._q):
            self._q, self._cost, self._impact, self._parent = (
                np.concatenate([values, np.zeros_like(values)])
                for values in (self._q, self._cost, self._impact, self._parent)
            )
        nodes = np.arange(self._n, self._n + len(q))
        self._q[nodes], self._cost[nodes], self._impact[nodes], self._parent[nodes] = q, cost, impact, -1
        self._children += [[] for _ in nodes]
        self._n += len(q)
        return nodes

"""A tree of configurations with a cached state cost per node."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float


@final
class Tree:
    """Nodes in the order of insertion; the first are roots.

    Args:
        roots: Configurations without a parent.
        costs: State cost of each root.
    """

    def __init__(self, roots: Float[Array, "root nq"], costs: Float[Array, " root"]) -> None:
        self._q = np.array(roots, dtype=np.float64)
        self._n = len(roots)
        self.costs: list[float] = [float(c) for c in costs]
        self.parents: list[int] = [-1] * len(roots)

    def __len__(self) -> int:
        return self._n

    @property
    def q(self) -> Float[Array, "node nq"]:
        """All configurations."""
        return self._q[: self._n]

    def add(self, q: Float[Array, " nq"], cost: float, parent: int) -> int:
        """Append a node and return its index."""
        if self._n == len(self._q):
            self._q = np.concatenate([self._q, np.zeros((max(256, self._n), self._q.shape[1]))])
        self._q[self._n] = q
        self.costs.append(float(cost))
        self.parents.append(parent)
        self._n += 1
        return self._n - 1

    def nearest(self, q: Float[Array, " nq"]) -> tuple[int, float]:
        """Return the nearest node and its distance [rad]. A linear scan is fastest below about 5000 nodes."""
        gap = self.q - q
        squared = np.einsum("ij,ij->i", gap, gap)
        i = int(squared.argmin())
        return i, float(np.sqrt(squared[i]))

    def branch(self, i: int) -> Float[Array, "node nq"]:
        """Return the configurations from the root to node `i`."""
        nodes = [i]
        while self.parents[nodes[-1]] >= 0:
            nodes.append(self.parents[nodes[-1]])
        return self._q[nodes[::-1]]


def steer(q0: Float[Array, " nq"], q1: Float[Array, " nq"], distance: float, reach: float) -> Float[Array, " nq"]:
    """Return the point at most `reach` from `q0` towards `q1`, which is `distance` away."""
    return q1.copy() if distance <= reach else q0 + reach / distance * (q1 - q0)

"""Record of the nodes of a tree that have not yet been extended towards a goal.

While the step from the nearest node to a goal is blocked, this node stays the nearest. A tree that always extends the
nearest node would try the same edge again and again.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float


@final
class Untried:
    """Pairs of node and goal, each returned once, the nearest node first.

    Args:
        goals: The goals.
    """

    def __init__(self, goals: Float[Array, "goal nq"]) -> None:
        self._goals = goals
        self._nodes: list[list[tuple[float, int]]] = [[] for _ in goals]
        self._known = 0
        self._excluded: set[tuple[int, int]] = set()

    def learn(self, q: Float[Array, "node nq"]) -> None:
        """Add the new nodes of a tree; `q` are all of its nodes."""
        new = q[self._known :]
        distances = np.linalg.norm(new[:, None, :] - self._goals, axis=2)
        for node, row in enumerate(distances.tolist(), start=self._known):
            for heap, distance in zip(self._nodes, row, strict=True):
                heappush(heap, (distance, node))
        self._known = len(q)

    def exclude(self, node: int, goal: int) -> None:
        """Mark a pair as tried."""
        self._excluded.add((node, goal))

    def take(self, goal: int) -> tuple[int, float] | None:
        """Return the nearest node that has not tried a goal, and its distance [rad]; None if all nodes have."""
        while self._nodes[goal]:
            distance, node = heappop(self._nodes[goal])
            if (node, goal) not in self._excluded:
                return node, distance
        return None

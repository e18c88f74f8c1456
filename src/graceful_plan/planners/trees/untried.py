"""Which nodes of a tree have not yet been extended towards which goal.

The node nearest to a goal stays the nearest for as long as the step from it is blocked: a tree that always extends that
one spends all of its samples of goals on one edge.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import final

import numpy as np

from graceful_plan.array_types import Float

Array = np.ndarray


@final
class Untried:
    """Pairs of node and goal, each handed out once, the nearest node first.

    Args:
        goals: The goals.
    """

    def __init__(self, goals: Float[Array, "goal nq"]) -> None:
        self._goals = goals
        self._nodes: list[list[tuple[float, int]]] = [[] for _ in goals]
        self._known = 0
        self._excluded: set[tuple[int, int]] = set()

    def learn(self, q: Float[Array, "node nq"]) -> None:
        """Take in the nodes that were added to a tree; `q` are all of its nodes."""
        new = q[self._known :]
        distances = np.linalg.norm(new[:, None, :] - self._goals, axis=2)
        for node, row in enumerate(distances.tolist(), start=self._known):
            for heap, distance in zip(self._nodes, row, strict=True):
                heappush(heap, (distance, node))
        self._known = len(q)

    def exclude(self, node: int, goal: int) -> None:
        """Never hand out this pair."""
        self._excluded.add((node, goal))

    def take(self, goal: int) -> tuple[int, float] | None:
        """Return the node nearest to a goal among those not handed out, and its distance [rad]; None if all were."""
        while self._nodes[goal]:
            distance, node = heappop(self._nodes[goal])
            if (node, goal) not in self._excluded:
                return node, distance
        return None

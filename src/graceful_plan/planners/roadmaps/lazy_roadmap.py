"""A roadmap that grows node by node, with lazy collision checks and cached edge costs.

Node i is connected to its k(i) nearest among the earlier nodes. So the graph of the first n samples is a subgraph of
the graph of the first n + m, for any batches, and more samples never make the best path worse.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.path import Path
from graceful_plan.planners.informed import InformedSampler
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem, out_of_time

_UNKNOWN, _FREE, _BLOCKED = 0, 1, 2
_NEIGHBOUR_CHUNK = 150_000  # distances per step, about 3 ms
_LEAST_COST = 1e-12  # the graph search ignores edges of cost 0


@final
class LazyRoadmap:
    """Nodes, edges to earlier nodes in compressed rows, and the cheapest path among them.

    Args:
        questions: Access to problem and objective.
        sampler: Provides the lower bound of the cost of a path through a node.
        symmetric: Whether an edge costs the same in both directions.
        neighbours: k(i), the number of earlier nodes that node i is connected to.
    """

    def __init__(
        self,
        questions: InterruptibleProblem,
        sampler: InformedSampler,
        symmetric: bool,
        neighbours: Callable[[Array], Array],
    ) -> None:
        problem = questions.problem
        self.questions, self.sampler = questions, sampler
        self.symmetric, self.neighbours = symmetric, neighbours
        self.goal_count = len(problem.goals)
        self.q = np.asarray(problem.start, dtype=np.float64)[None]
        self.row_begin = np.zeros(2, dtype=np.int32)
        self.earlier = np.zeros(0, dtype=np.int32)
        self.cost_down = np.zeros(0)  # from the later node to the earlier one
        self.cost_up = np.zeros(0)
        self.state = np.zeros(0, dtype=np.int8)
        self.add(np.asarray(problem.goals, dtype=np.float64), np.inf)

    def __len__(self) -> int:
        return len(self.q)

    def add(self, q: Float[Array, "n nq"], best: float) -> None:
        """Add free configurations; edges that cannot be part of a path cheaper than `best` are left out."""
        if len(q) == 0:
            return
        nodes = np.concatenate([self.q, q])
        later, earlier = self._edges_of_new(nodes, len(self.q))
        length = np.linalg.norm(nodes[later] - nodes[earlier], axis=1)
        bound = self._bound(nodes[later], nodes[earlier], length)
        useful = np.flatnonzero(bound < best)
        down = np.full(len(later), np.inf)
        down[useful] = self.questions.edge_costs(nodes[later[useful]], nodes[earlier[useful]])
        up = down
        if not self.symmetric:
            up = np.full(len(later), np.inf)
            up[useful] = self.questions.edge_costs(nodes[earlier[useful]], nodes[later[useful]])
        per_row = np.bincount(later - len(self.q), minlength=len(q))
        self.row_begin = np.concatenate([self.row_begin, self.row_begin[-1] + np.cumsum(per_row)]).astype(np.int32)
        self.q = nodes
        self.earlier = np.concatenate([self.earlier, earlier.astype(np.int32)])
        self.cost_down = np.concatenate([self.cost_down, np.maximum(down, _LEAST_COST)])
        self.cost_up = np.concatenate([self.cost_up, np.maximum(up, _LEAST_COST)])
        self.state = np.concatenate([self.state, np.zeros(len(later), dtype=np.int8)])

    def cheapest(self, best: float) -> tuple[float, Path] | None:
        """Find the cheapest free path if it costs less than `best`; only edges on candidate paths are checked."""
        while True:
            if out_of_time(self.questions.budget):
                raise Interrupted
            found = self._shortest(best)
            if found is None:
                return None
            cost, nodes = found
            edges = self._edge_ids(nodes)
            unknown = np.flatnonzero(self.state[edges] == _UNKNOWN)
            free = self.questions.edges_free(self.q[nodes[unknown]], self.q[nodes[unknown + 1]])
            self.state[edges[unknown]] = np.where(free, _FREE, _BLOCKED)
            if free.all():
                return cost, Path(self.q[nodes])

    def _bound(self, a: Array, b: Array, length: Array) -> Array:
        """Return a lower bound of the cost of any path over the edge from `a` to `b`, by the triangle inequality."""
        through = np.maximum(self.sampler.bound_through(a), self.sampler.bound_through(b))
        return np.maximum(through, self.sampler.length_bound * length)

    def _edges_of_new(self, nodes: Array, first: int) -> tuple[Int[Array, " edge"], Int[Array, " edge"]]:
        later, earlier = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
        rows = max(1, _NEIGHBOUR_CHUNK // len(nodes))
        for begin in range(first, len(nodes), rows):
            if out_of_time(self.questions.budget):
                raise Interrupted
            new = np.arange(begin, min(begin + rows, len(nodes)))
            each, near = _nearest_earlier(nodes, new, np.minimum(new, self.neighbours(new)))
            later.append(each)
            earlier.append(near)
        return np.concatenate(later), np.concatenate(earlier)

    def _shortest(self, best: float) -> tuple[float, Int[Array, " node"]] | None:
        from scipy.sparse import csr_array  # scipy is imported only when needed
        from scipy.sparse.csgraph import dijkstra

        shape = (len(self.q), len(self.q))
        blocked = self.state == _BLOCKED
        down = np.where(blocked, np.inf, self.cost_down)
        up = down if self.symmetric else np.where(blocked, np.inf, self.cost_up)
        graph = csr_array((down, self.earlier, self.row_begin), shape=shape)
        graph = graph + csr_array((up, self.earlier, self.row_begin), shape=shape).T.tocsr()
        limit = best if np.isfinite(best) else np.inf
        distance, before = dijkstra(graph, indices=0, return_predecessors=True, limit=limit)
        goal = 1 + int(np.argmin(distance[1 : 1 + self.goal_count]))
        if not distance[goal] < best:
            return None
        nodes = [goal]
        while nodes[-1] != 0:
            nodes.append(int(before[nodes[-1]]))
        return float(distance[goal]), np.array(nodes[::-1])

    def _edge_ids(self, nodes: Array) -> Int[Array, " edge"]:
        high, low = np.maximum(nodes[:-1], nodes[1:]), np.minimum(nodes[:-1], nodes[1:])
        return np.array(
            [
                self.row_begin[h] + np.searchsorted(self.earlier[self.row_begin[h] : self.row_begin[h + 1]], node)
                for h, node in zip(high, low, strict=True)
            ],
            dtype=int,
        )


def _nearest_earlier(nodes: Array, new: Array, k: Array) -> tuple[Array, Array]:
    """Return for each of the `new` nodes the k nearest earlier nodes, by ascending index."""
    most = int(k.max())
    end = int(new[-1]) + 1
    gap = nodes[new][:, None, :] - nodes[None, :end, :]
    distance = np.einsum("ijk,ijk->ij", gap, gap)
    distance[np.arange(end) >= new[:, None]] = np.inf
    near = np.argpartition(distance, most - 1, axis=1)[:, :most]
    order = np.argsort(np.take_along_axis(distance, near, axis=1), axis=1, kind="stable")
    near = np.take_along_axis(near, order, axis=1)
    near[np.arange(most) >= k[:, None]] = end  # beyond every index: sorted to the back, then cut off
    near.sort(axis=1)
    row, column = np.nonzero(near < end)
    return new[row], near[row, column]

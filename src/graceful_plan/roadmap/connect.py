"""Connection of a start and goals to a roadmap: the graph of one query."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.path import Path
from graceful_plan.planners.roadmaps.edge_prices import Edges
from graceful_plan.planners.roadmaps.graph import Graph
from graceful_plan.planners.roadmaps.growth import nearest
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.roadmap.exposure import Exposure
from graceful_plan.roadmap.ground import MARGIN, problem_of

NEAREST = 12
"""Number of nearest nodes that each end is connected to."""
BETWEEN = 12
"""Number of nodes between start and goal that each end is connected to."""


@dataclass(frozen=True, eq=False)
class Joined:
    """A roadmap with a start and goals connected to it.

    | field | meaning                                                        | unit     | shape   |
    |-------|----------------------------------------------------------------|----------|---------|
    | q     | nodes of the roadmap, then those of the start and of the goals | rad or m | node nq |
    | base  | edges of the roadmap                                           |          |         |
    | own   | edges to and between the ends; ids follow those of `base`      |          |         |
    | start | node of the start                                              |          |         |
    | goals | nodes of the goals                                             |          | goal    |
    """

    q: Float[Array, "node nq"]
    base: Edges
    own: Edges
    start: int
    goals: Int[Array, " goal"]

    @cached_property
    def graph(self) -> Graph:
        """Graph of all nodes and edges."""
        tail, head = (np.concatenate([getattr(edges, k) for edges in (self.base, self.own)]) for k in ("tail", "head"))
        return Graph(len(self.q), tail, head)

    def costs(
        self, impact: Float[Array, " base_edge"], severity: Float[Array, " column"]
    ) -> tuple[Float[Array, " edge"], Float[Array, " edge"]]:
        """Motion and impact of each edge.

        Args:
            impact: Impact of the roadmap's edges under these severities.
            severity: Severities for the impact of the other edges.
        """
        motion = np.concatenate([self.base.prices.motion, self.own.prices.motion])
        return motion, np.concatenate([impact, self.own.prices.impact(severity)])

    def ends_of(self, steps: Int[Array, " step"]) -> tuple[Float[Array, "step nq"], Float[Array, "step nq"]]:
        """Return the configurations at the start and the end of each edge."""
        return self.q[self.graph.tail[steps]], self.q[self.graph.head[steps]]

    def path(self, steps: Int[Array, " step"]) -> Path:
        """Return the path along a sequence of edges."""
        begin, end = self.ends_of(steps)
        return Path(np.concatenate([begin[:1], end])).without_duplicates()


def join(q: Float[Array, "node nq"], edges: Edges, exposure: Exposure, ends: Endpoints) -> Joined:
    """Connect a start and goals to a roadmap, and to each other, by new free edges.

    Args:
        q: Nodes of the roadmap.
        edges: Edges of the roadmap.
        exposure: Evaluates the costs of the new edges.
        ends: Start and goals; their escape paths become part of the graph.
    """
    chains = [ends.departure.q, *(arrival.q for arrival in ends.arrivals)]
    first = len(q) + np.cumsum([0, *map(len, chains)])
    nodes = np.concatenate([q, *chains])
    departs, arrives = int(first[1]) - 1, first[1:-1]  # nodes at which the escape paths meet the roadmap
    links = _links(q, nodes[departs], nodes[arrives], departs, arrives)
    problem = problem_of(ends.constraints, min(MARGIN, 0.5 * ends.clearance))
    free = problem.edges_free(nodes[links[:, 0]], nodes[links[:, 1]])
    out = [np.stack([np.arange(a, b - 1), np.arange(a + 1, b)], axis=1) for a, b in pairwise(first.tolist())]
    tail, head = np.concatenate([links[free], *out]).astype(np.int32).T
    new = Edges(tail, head, exposure.price(nodes[tail], nodes[head]))
    return Joined(nodes, edges, new, int(first[0]), first[2:] - 1)


def _links(
    q: Float[Array, "node nq"],
    start: Float[Array, " nq"],
    goals: Float[Array, "goal nq"],
    departs: int,
    arrives: Int[Array, " goal"],
) -> Int[Array, "link 2"]:
    """Return the pairs of nodes to try to connect."""
    links = [np.stack([np.full(len(goals), departs), arrives], axis=1)]
    for goal, node in zip(goals, arrives.tolist(), strict=True):
        between = np.linalg.norm(q - start, axis=1) + np.linalg.norm(q - goal, axis=1)
        middle = np.argsort(between, kind="stable")[:BETWEEN]
        leave, enter = (np.union1d(nearest(end[None], q, NEAREST)[0], middle) for end in (start, goal))
        links += [np.stack([np.full(len(leave), departs), leave], axis=1)]
        links += [np.stack([enter, np.full(len(enter), node)], axis=1)]
    return np.unique(np.concatenate(links), axis=0)

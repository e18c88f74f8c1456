"""A roadmap of one scene: built once, asked again and again for other weights, severities, starts and goals."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Mapping, Sequence

import numpy as np

from graceful_plan.arguments import checked_objective, checked_seed, checked_time_limit
from graceful_plan.array_types import Float
from graceful_plan.costs.objective import Objective
from graceful_plan.ends import Ends
from graceful_plan.exceptions import SettingError
from graceful_plan.goals import Configuration, Goal
from graceful_plan.planners.edge_prices import Edges
from graceful_plan.planners.growth import Growth
from graceful_plan.planners.settings import count
from graceful_plan.roadmap.answers import FrontPath, QueryResult, QueryStatus
from graceful_plan.roadmap.connect import Joined, join
from graceful_plan.roadmap.exposure import Exposure
from graceful_plan.roadmap.ground import Motion, declared_motions, find_ends, ground_of, usable_pairs
from graceful_plan.scene import Scene
from graceful_plan.severity import SeverityTable

Array = np.ndarray
Severity = SeverityTable | Mapping[str, float | Mapping[str, float]]
"""Other severities, as `Scene.with_severity` takes them."""

_KEPT = 8
"""Pairs of ends whose edges to the roadmap are kept."""


class Roadmap:
    """Nodes and edges that are free, with cached costs. Made by `build` or `load`.

    Args:
        scene: The scene, with what is carried attached.
        objective: What paths cost; its weight is the default one of queries.
        q: Nodes.
        edges: Directed edges between them, with their prices.
    """

    def __init__(self, scene: Scene, objective: Objective, q: Float[Array, "node nq"], edges: Edges) -> None:
        self.scene, self.objective, self.q, self.edges = scene, objective, q, edges
        self.exposure = Exposure(objective, scene)
        self._joined: OrderedDict[bytes, Joined] = OrderedDict()

    def __len__(self) -> int:
        return len(self.q)

    @classmethod
    def build(
        cls,
        scene: Scene,
        *,
        objective: Objective | None = None,
        nodes: int = 1500,
        neighbours: int = 8,
        motions: Sequence[Motion] | None = None,
        seed: int = 0,
        time_limit: float | None = None,
    ) -> Roadmap:
        """Draw nodes, join neighbours by edges that are free at a fine step, and price these.

        Args:
            scene: The scene, with what is carried attached.
            objective: Motion and impact; the default `Objective()` if None.
            nodes: How many nodes.
            neighbours: How many nearest nodes the first nodes are joined to; the other ones to half as many.
            motions: Starts and goals, as `plan` takes them, that the roadmap is made for: it is dense where good paths
                between them pass, and serves others, too. Default: the scene's tasks with what is held; without any,
                the ways between all keyframes.
            seed: Of all random numbers; without a time limit, nothing else decides what comes out.
            time_limit: Seconds after which the roadmap stays as it is; it may have fewer nodes then.

        Raises:
            GracefulPlanError: For misuse: settings outside of their range, motions that do not fit the scene.
        """
        started = time.perf_counter()
        count("nodes", nodes)
        count("neighbours", neighbours)
        rng, chosen = checked_seed(seed), checked_objective(objective, None, 1.0)
        limit = np.inf if time_limit is None else checked_time_limit(time_limit, None)
        exposure = Exposure(chosen, scene)
        pairs = usable_pairs(declared_motions(scene) if motions is None else motions, scene, rng)
        growth = Growth(ground_of(exposure), pairs, neighbours, rng, started + limit)
        growth.grow(nodes)
        return cls(scene, chosen, growth.q, growth.edges)

    def query(
        self,
        start: Configuration,
        goal: Goal,
        *,
        w: float | None = None,
        severity: Severity | None = None,
        seed: int = 0,
    ) -> QueryResult:
        """Find the cheapest path of the roadmap.

        Args:
            start: Configuration [rad or m], or the name of a keyframe.
            goal: Configuration, keyframe, several of them, or a `PoseGoal` for the tool.
            w: Safety weight; the objective's by default.
            severity: Other severities, as for `Scene.with_severity`.
            seed: Of the random numbers of inverse kinematics.

        Raises:
            GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside of their range.
        """
        weight = checked_objective(self.objective, w, 1.0).w
        severities = self._severity(severity)
        ends = find_ends(start, goal, self.scene, np.random.default_rng(0), seed)
        if isinstance(ends, QueryResult):
            return ends
        joined = self.joined(ends[0])
        steps, _ = joined.graph.cheapest(
            joined.edges.prices.motion + weight * joined.impact(severities), joined.start, joined.goals
        )
        if len(steps) == 0:
            return QueryResult(status=QueryStatus.NOT_CONNECTED)
        path = joined.path(steps)
        cost = self.exposure.breakdown(self.exposure.finely().price(path.q[:-1], path.q[1:]), severities, weight)
        index = ends[1][int(np.flatnonzero(joined.goals == joined.edges.head[steps[-1]])[0])]
        return QueryResult(status=QueryStatus.FOUND, path=path, cost=cost, goal_index=index)

    def front(
        self,
        start: Configuration,
        goal: Goal,
        *,
        epsilon: float = 0.01,
        severity: Severity | None = None,
        max_points: int | None = None,
        seed: int = 0,
    ) -> list[FrontPath]:
        """Find the paths of the roadmap none of which another one of it dominates in motion and impact.

        Weighted sums reach the convex hull of a front only; this is all of it. The search is exact in the costs that
        the roadmap has stored. The costs that are returned are computed by finer samples, and a path that turns out to
        be dominated is left out.

        Args:
            start: As for `query`.
            goal: As for `query`.
            epsilon: 0 for all paths; otherwise a selection in which for every path of the roadmap there is one with no
                more motion and at most `1 + epsilon` times its impact.
            severity: Other severities, as for `Scene.with_severity`.
            max_points: Most paths to return: both ends of the front, and others as evenly spread as there are.
            seed: Of the random numbers of inverse kinematics.

        Returns:
            By ascending motion and descending impact; empty if the ends cannot be used or are not connected, of which
            `query` knows the reason.

        Raises:
            GracefulPlanError: For misuse, as `query`.
        """
        if max_points is not None:
            count("max_points", max_points)
        severities = self._severity(severity)
        ends = find_ends(start, goal, self.scene, np.random.default_rng(0), seed)
        if isinstance(ends, QueryResult):
            return []
        joined = self.joined(ends[0])
        cost = np.stack([joined.edges.prices.motion, joined.impact(severities)], axis=1)
        found = joined.graph.front(cost, joined.start, joined.goals, epsilon)
        steps, place = np.unique(np.concatenate([np.zeros(0, int), *found.edges]), return_inverse=True)
        fine = self.exposure.finely().price(joined.q[joined.edges.tail[steps]], joined.q[joined.edges.head[steps]])
        both = np.stack([fine.motion, fine.impact(severities)], axis=1)[place]
        lengths = [len(path) for path in found.edges]
        totals = np.array([part.sum(axis=0) for part in np.split(both, np.cumsum(lengths)[:-1])]).reshape(-1, 2)
        kept = spread_out(totals, non_dominated(totals), max_points)
        return [FrontPath(joined.path(found.edges[k]).q, *totals[k].tolist()) for k in kept]

    def joined(self, ends: Ends) -> Joined:
        """Return the graph of the roadmap and these ends; that of the last few ends is kept."""
        key = b"".join(chain.tobytes() + b"|" for chain in (ends.departure.q, *(way.q for way in ends.arrivals)))
        if key not in self._joined:
            while len(self._joined) >= _KEPT:
                self._joined.popitem(last=False)
            self._joined[key] = join(self.q, self.edges, self.exposure, ends)
        return self._joined[key]

    def _severity(self, severity: Severity | None) -> Float[Array, " column"]:
        if severity is not None and not self.exposure.by_hazard:
            raise SettingError("severity", severity, "None: the impact of this roadmap is not one of severities")
        return self.exposure.severity(self.scene if severity is None else self.scene.with_severity(severity))


def non_dominated(cost: Float[Array, "n 2"]) -> Array:
    """Return which rows no other one dominates, by ascending first cost; of equal ones the first."""
    order = np.lexsort((np.arange(len(cost)), cost[:, 1], cost[:, 0]))
    second = cost[order, 1]
    least_before = np.concatenate([[np.inf], np.minimum.accumulate(second)[:-1]])
    return order[second < least_before]


def spread_out(cost: Float[Array, "n 2"], kept: Array, most: int | None) -> Array:
    """Choose at most so many points of a front: its ends, then time and again the one farthest from those chosen."""
    if most is None or len(kept) <= most:
        return kept
    points = cost[kept]
    points = (points - points.min(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-300)
    chosen = [0, len(kept) - 1][:most]
    while len(chosen) < most:
        away = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(away)))
    return kept[np.sort(chosen)]

"""A roadmap of one scene: built once, then queried with any weights, severities, starts and goals."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError
from graceful_plan.planners.roadmaps.edge_prices import Edges
from graceful_plan.planners.roadmaps.graph import non_dominated, spread_out
from graceful_plan.planners.roadmaps.growth import Growth
from graceful_plan.query.arguments import check_no_base, checked_objective, checked_seed, checked_time_limit
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.endpoints.goals import Goal
from graceful_plan.roadmap.answers import FrontPath, QueryResult, QueryStatus
from graceful_plan.roadmap.connect import Joined, join
from graceful_plan.roadmap.exposure import Exposure
from graceful_plan.roadmap.ground import Motion, declared_motions, ground_of, usable_ends, usable_pairs
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import count

Severity = SeverityTable | Mapping[str, float | Mapping[str, float]]
"""Severities that replace those of the scene, as for `Scene.with_severity`."""

_MOST_NODES, _MOST_NEIGHBOURS = 1_000_000, 1000
"""Largest values of `nodes` and `neighbours`; the number of edges is their product, and all edges are in memory."""
_KEPT = 8
"""Number of cached graphs of pairs of ends, and of cached impacts for sets of severities."""


class Roadmap:
    """Free nodes and edges with cached costs. Create it with `build`.

    Args:
        scene: The scene, with the carried object attached.
        objective: Objective of paths; its weight is the default weight of queries.
        q: Nodes.
        edges: Directed edges between the nodes, with their costs.
        constraints: Constraints that hold at all nodes and along all edges.
    """

    def __init__(
        self,
        scene: Scene,
        objective: Objective,
        q: Float[Array, "node nq"],
        edges: Edges,
        constraints: SceneConstraints,
    ) -> None:
        self.scene, self.objective, self.q, self.edges = scene, objective, q, edges
        self.constraints = constraints
        self.exposure = Exposure(objective, scene)
        self._joined: OrderedDict[tuple[bytes, ...], Joined] = OrderedDict()
        self._impact: OrderedDict[bytes, Float[Array, " edge"]] = OrderedDict()

    def __len__(self) -> int:
        return len(self.q)

    def __reduce__(self) -> Any:
        """Refuse pickling.

        Raises:
            TypeError: Always; the message says why.
        """
        raise TypeError(
            f"a Roadmap refers to its scene {self.scene.name!r}, which cannot be pickled; load the scene and build the"
            " roadmap in each process: the same seed without a time limit gives the same roadmap"
        )

    @classmethod
    def build(
        cls,
        scene: Scene,
        *,
        objective: Objective | None = None,
        nodes: int = 1500,
        neighbours: int = 8,
        motions: Sequence[Motion] | None = None,
        constraints: Iterable[Constraint] | None = None,
        seed: int = 0,
        time_limit: float | None = None,
    ) -> Roadmap:
        """Sample nodes, connect neighbours by edges that are free at a fine step, and evaluate the edge costs.

        Args:
            scene: The scene, with the carried object attached.
            objective: Motion cost and impact; the default `Objective()` if None.
            nodes: Number of nodes; the ends of `motions` are nodes in any case.
            neighbours: Number of nearest nodes that each of the first nodes is connected to; later nodes: half as many.
            motions: Starts and goals, as for `plan`, that the roadmap is built for. It is dense along good paths
                between them, and serves other queries, too. Unusable motions are skipped. Default: the scene's tasks
                with the held object; if there are none, all pairs of keyframes.
            constraints: Constraints in addition to collision, as for `plan`. Default: those that the scene declares,
                and that contents and grasp hold. They are checked at rest; timing limits the speed along a path.
            seed: Seed of all random numbers; without a time limit, the result depends on nothing else.
            time_limit: Time after which growth ends [s], maybe with fewer nodes.

        Raises:
            GracefulPlanError: For misuse: settings outside their range, motions that do not fit the scene.
        """
        started = time.perf_counter()
        check_no_base(scene, "a roadmap")
        count("nodes", nodes, most=_MOST_NODES)
        count("neighbours", neighbours, most=_MOST_NEIGHBOURS)
        rng, chosen = checked_seed(seed), checked_objective(objective, None)
        limit = np.inf if time_limit is None else checked_time_limit(time_limit, None)
        exposure = Exposure(chosen, scene)
        held = SceneConstraints(scene, default_constraints(scene) if constraints is None else constraints)
        pairs = usable_pairs(declared_motions(scene) if motions is None else motions, held, rng)
        growth = Growth(ground_of(exposure, held), pairs, neighbours, rng, started + limit)
        growth.grow(nodes)
        return cls(scene, chosen, growth.q, growth.edges, held)

    def query(
        self,
        start: Configuration,
        goal: Goal,
        scene: Scene | None = None,
        *,
        w: float | None = None,
        severity: Severity | None = None,
        seed: int = 0,
    ) -> QueryResult:
        """Find the cheapest path in the roadmap.

        Args:
            start: Configuration [rad or m], or the name of a keyframe.
            goal: Configuration, keyframe, `PoseGoal` for the tool, or several of these.
            scene: Scene with the severities to use: the roadmap's scene (default), or a copy from
                `Scene.with_severity` or `Scene.without_moving`.
            w: Safety weight; default: the weight of the objective.
            severity: Severities that replace those of the scene, as for `Scene.with_severity`.
            seed: Seed of the random numbers of inverse kinematics.

        Raises:
            GracefulPlanError: For misuse: another scene, wrong shapes, NaN, unknown names, settings outside their
                range.
        """
        weight = checked_objective(self.objective, w).w
        severities = self.severity(scene, severity)
        ends = usable_ends(start, goal, self.constraints, np.random.default_rng(0), self.objective, seed)
        if isinstance(ends, QueryResult):
            return ends
        joined = self.joined(ends)
        motion, impact = joined.costs(self.impact(severities), severities)
        steps, _ = joined.graph.cheapest(motion + weight * impact, joined.start, joined.goals)
        if len(steps) == 0:
            return QueryResult(status=QueryStatus.NOT_CONNECTED)
        path = joined.path(steps)
        cost = self.exposure.breakdown(self.exposure.reported().price(path.q[:-1], path.q[1:]), severities, weight)
        index = ends.goal_index[int(np.flatnonzero(joined.goals == joined.graph.head[steps[-1]])[0])]
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
        """Find the Pareto front of the roadmap's paths in motion cost and impact.

        Minimising weighted sums gives only the convex hull of a front; this method finds all of it. The search is exact
        in the stored edge costs, at the paces of real motions. The returned costs are those of `evaluate`; paths that
        are dominated in these are left out.

        Args:
            start: As for `query`.
            goal: As for `query`.
            epsilon: 0 for all paths of the front. Otherwise the result has, for every path of the roadmap, one with at
                most its motion cost and at most `1 + epsilon` times its impact.
            severity: Severities that replace those of the scene, as for `Scene.with_severity`.
            max_points: Largest number of paths: both ends of the front, and others as evenly spread as possible.
            seed: Seed of the random numbers of inverse kinematics.

        Returns:
            Paths by ascending motion cost and descending impact; empty if the ends cannot be used or are not connected.
            `query` tells the reason.

        Raises:
            GracefulPlanError: For misuse, as for `query`.
        """
        if max_points is not None:
            count("max_points", max_points)
        severities = self.severity(None, severity)
        ends = usable_ends(start, goal, self.constraints, np.random.default_rng(0), self.objective, seed)
        if isinstance(ends, QueryResult):
            return []
        joined = self.joined(ends)
        cost = joined.costs(self.impact(severities), severities)
        found = joined.graph.front(np.stack(cost, axis=1), joined.start, joined.goals, epsilon)
        if not found.edges:
            return []
        steps, place = np.unique(np.concatenate(found.edges), return_inverse=True)
        fine = self.exposure.reported().price(*joined.ends_of(steps))
        both = np.stack([fine.motion, fine.impact(severities)], axis=1)[place]
        lengths = [len(path) for path in found.edges]
        totals = np.array([part.sum(axis=0) for part in np.split(both, np.cumsum(lengths)[:-1])])
        kept = spread_out(totals, non_dominated(totals), max_points)
        return [FrontPath(joined.path(found.edges[k]).q, *totals[k].tolist()) for k in kept]

    def joined(self, ends: Endpoints) -> Joined:
        """Return the graph of the roadmap with these ends; graphs of the latest ends are cached."""
        key = (ends.departure.q.tobytes(), *(arrival.q.tobytes() for arrival in ends.arrivals))
        found = self._joined.get(key)
        if found is None:
            found = join(self.q, self.edges, self.exposure, ends)
            _keep(self._joined, key, found)
        return found

    def impact(self, severity: Float[Array, " column"]) -> Float[Array, " edge"]:
        """Return the impact S of each edge under these severities; results for the latest severities are cached."""
        key = severity.tobytes()
        found = self._impact.get(key)
        if found is None:
            found = self.edges.prices.impact(severity)
            _keep(self._impact, key, found)
        return found

    def severity(self, scene: Scene | None = None, severity: Severity | None = None) -> Float[Array, " column"]:
        """Return the severity of each column of the exposures.

        Args:
            scene: Scene with the severities; the roadmap's scene by default.
            severity: Severities that replace those of the scene, as for `Scene.with_severity`.

        Raises:
            SettingError: If the scene is another one, or if severities are given for an impact that does not use them.
        """
        if severity is not None and not self.exposure.by_entity:
            raise SettingError("severity", severity, "None: the impact of this roadmap does not use severities")
        chosen = self.scene if scene is None else scene
        if not (chosen is self.scene or _same_but_for_severity(self.scene, chosen)):
            raise SettingError("scene", chosen.name, "the roadmap's scene, or a copy of it with other severities")
        return self.exposure.severity(chosen if severity is None else chosen.with_severity(severity))


def _same_but_for_severity(own: Scene, other: Scene) -> bool:
    """Return whether a scene differs from the roadmap's only in severities, or in that moving entities are removed."""
    skipped = {"severity", "overrides"} if other.moving else {"severity", "overrides", "moving"}
    names = (field.name for field in fields(own.notes) if field.name not in skipped)
    pairs = ((getattr(own.notes, name), getattr(other.notes, name)) for name in names)
    return own.model is other.model and all(a is b or a == b for a, b in pairs)


def _keep(kept: OrderedDict[Any, Any], key: object, value: object) -> None:
    """Add a value to a cache; drop the oldest ones if it is full."""
    while len(kept) >= _KEPT:
        kept.popitem(last=False)
    kept[key] = value

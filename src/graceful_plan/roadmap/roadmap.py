"""A roadmap of one scene: built once, asked again and again for other weights, severities, starts and goals."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError
from graceful_plan.planners.roadmaps.edge_prices import Edges
from graceful_plan.planners.roadmaps.graph import non_dominated, spread_out
from graceful_plan.planners.roadmaps.growth import Growth
from graceful_plan.planners.settings import count
from graceful_plan.query.arguments import check_stands, checked_objective, checked_seed, checked_time_limit
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.endpoints.goals import Goal
from graceful_plan.roadmap.answers import FrontPath, QueryResult, QueryStatus
from graceful_plan.roadmap.connect import Joined, join
from graceful_plan.roadmap.exposure import Exposure
from graceful_plan.roadmap.ground import Motion, declared_motions, ground_of, usable_ends, usable_pairs
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.scene import Scene

Array = np.ndarray
Severity = SeverityTable | Mapping[str, float | Mapping[str, float]]
"""Other severities, as `Scene.with_severity` takes them."""

_MOST_NODES, _MOST_NEIGHBOURS = 1_000_000, 1000
"""What a roadmap may be asked for: edges are as many as nodes times neighbours, and all of them are in memory."""
_KEPT = 8
"""How many graphs of pairs of ends are kept, and how many sets of severities."""


class Roadmap:
    """Nodes and edges that are free, with cached costs. Made by `build`.

    Args:
        scene: The scene, with what is carried attached.
        objective: What paths cost; its weight is the default one of queries.
        q: Nodes.
        edges: Directed edges between them, with their prices.
        constraints: What holds in and along all of them.
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
        """Draw nodes, join neighbours by edges that are free at a fine step, and price these.

        Args:
            scene: The scene, with what is carried attached.
            objective: Motion and impact; the default `Objective()` if None.
            nodes: How many nodes; at least the ends of the motions that it is made for.
            neighbours: How many nearest nodes the first nodes are joined to; the other ones to half as many.
            motions: Starts and goals, as `plan` takes them, that the roadmap is made for: it is dense where good paths
                between them pass, and serves others, too. Those that cannot be used are skipped. Default: the scene's
                tasks with what is held; without any, the ways between all keyframes.
            constraints: What has to hold besides not to collide, as `plan` takes it: by default what the scene asks
                for, and that contents and grasp hold; at rest, for how fast a path may be travelled is up to timing.
            seed: Of all random numbers; without a time limit, nothing else decides what comes out.
            time_limit: Seconds after which the roadmap stays as it is; it may have fewer nodes then.

        Raises:
            GracefulPlanError: For misuse: settings outside of their range, motions that do not fit the scene.
        """
        started = time.perf_counter()
        check_stands(scene, "a roadmap")
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
        """Find the cheapest path of the roadmap.

        Args:
            start: Configuration [rad or m], or the name of a keyframe.
            goal: Configuration, keyframe, `PoseGoal` for the tool, or several of these.
            scene: Where severities are from: the roadmap's scene, or what `Scene.with_severity` or
                `Scene.without_moving` makes of it.
            w: Safety weight; the objective's by default.
            severity: Other severities, as for `Scene.with_severity`.
            seed: Of the random numbers of inverse kinematics.

        Raises:
            GracefulPlanError: For misuse: another scene, wrong shapes, NaN, unknown names, settings outside of their
                range.
        """
        weight = checked_objective(self.objective, w).w
        severities = self.severity(scene, severity)
        ends = usable_ends(start, goal, self.constraints, np.random.default_rng(0), seed)
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
        """Find the paths of the roadmap none of which another one of it dominates in motion and impact.

        Weighted sums reach the convex hull of a front only; this is all of it. The search is exact in the costs that
        the roadmap has stored, at the paces of real motions. The costs that are returned are those of `evaluate`, and a
        path that turns out to be dominated by them is left out.

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
        severities = self.severity(None, severity)
        ends = usable_ends(start, goal, self.constraints, np.random.default_rng(0), seed)
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
        """Return the graph of the roadmap and these ends; that of the last few ends is kept."""
        key = (ends.departure.q.tobytes(), *(arrival.q.tobytes() for arrival in ends.arrivals))
        found = self._joined.get(key)
        if found is None:
            found = join(self.q, self.edges, self.exposure, ends)
            _keep(self._joined, key, found)
        return found

    def impact(self, severity: Float[Array, " column"]) -> Float[Array, " edge"]:
        """S of each edge under these severities; that of the last few is kept, as is the graph of the last few ends."""
        key = severity.tobytes()
        found = self._impact.get(key)
        if found is None:
            found = self.edges.prices.impact(severity)
            _keep(self._impact, key, found)
        return found

    def severity(self, scene: Scene | None = None, severity: Severity | None = None) -> Float[Array, " column"]:
        """Return severities by column of the exposures.

        Args:
            scene: Where they are from; the roadmap's scene by default.
            severity: Replacements, as for `Scene.with_severity`.

        Raises:
            SettingError: If the scene is another one, or if there are replacements although the impact is not one of
                severities.
        """
        if severity is not None and not self.exposure.by_hazard:
            raise SettingError("severity", severity, "None: the impact of this roadmap is not one of severities")
        chosen = self.scene if scene is None else scene
        if not (chosen is self.scene or _same_but_for_severity(self.scene, chosen)):
            raise SettingError("scene", chosen.name, "the roadmap's own, or that with other severities")
        return self.exposure.severity(chosen if severity is None else chosen.with_severity(severity))


def _same_but_for_severity(own: Scene, other: Scene) -> bool:
    """Tell whether one scene comes of the other by new severities, and perhaps without what moves in it."""
    skipped = {"severity", "overrides"} if other.moving else {"severity", "overrides", "moving"}
    names = (field.name for field in fields(own.notes) if field.name not in skipped)
    pairs = ((getattr(own.notes, name), getattr(other.notes, name)) for name in names)
    return own.model is other.model and all(a is b or a == b for a, b in pairs)


def _keep(kept: OrderedDict[Any, Any], key: object, value: object) -> None:
    """Keep a value, and no more of the others than there is room for."""
    while len(kept) >= _KEPT:
        kept.popitem(last=False)
    kept[key] = value

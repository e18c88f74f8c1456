"""Poses of a base in OMPL: its Reeds-Shepp space with this library's collision checks and costs, in short slices.

The module imports OMPL, so planners import it only when they run. See `session` for the requirements of the bindings.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import final

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.mobile.floor.reeds_shepp import Steering, shortest_curves
from graceful_plan.planners.interruptible import checked_costs
from graceful_plan.planners.ompl.kind import Kind
from graceful_plan.planners.ompl.session import end_of_slice, quiet
from graceful_plan.planners.planner import BoundObjective, Budget, Problem, edge_totals

Pose = tuple[float, float, float]

_CHORD = 0.1
"""Largest length of the chords that approximate curves [m]."""
_TURN = 0.35
"""Largest turn of a curve over a chord [rad]."""
_KEPT_CURVES = 20_000
_ROADMAP = "PRM"
"""The planner whose `solve` is not used: it checks the clock and searches paths on a second thread, which deadlocks
with
Python. OMPL only grows the roadmap, on this thread; paths over it are searched here."""
_GROWN = 1.3
"""Growth factor of a roadmap between searches for a path."""
_JOINED = 10
"""Number of milestones that each end is connected to."""


@final
class PoseSession:
    """One planner on one problem.

    Args:
        asked: Problem, objective and budget.
        seed: Seed of OMPL's generator, > 0.
        kind: The planner.
        ends: Start, and goals with the same arm posture.
    """

    def __init__(
        self,
        asked: tuple[Problem, BoundObjective, Budget],
        seed: int,
        kind: Kind,
        ends: tuple[Float[Array, " nq"], Float[Array, "goal nq"]],
    ) -> None:
        self.problem, self.objective, self.budget = asked
        self.seed, self.kind, (self.start, self.goals) = seed, kind, ends

    def run(self, radius: float, around: float) -> Iterator[Float[Array, "vertex nq"]]:
        """Yield each new path that OMPL finds; see `PoseSpace` for the settings."""
        curves = _Curves(self.problem, self.objective, Steering(radius=radius), self.start)
        with quiet():
            ou.RNG.setSeed(self.seed)  # before any object that draws random numbers is built
            space = ob.ReedsSheppStateSpace(radius)
            space.setBounds(self._bounds(around))
            si = ob.SpaceInformation(space)
            si.setStateValidityChecker(lambda s: curves.state_free(_pose(s)))
            si.setMotionValidator(_CurveValidator(si, curves))
            si.setup()
            definition = self._definition(si, curves)
            planner = getattr(og, self.kind.name)(si)
            self.kind.configure(planner)
            planner.setProblemDefinition(definition)
            planner.setup()
        before = np.zeros((0, 3))
        looked = 0.0
        while not self.budget.exhausted:
            if self.kind.name == _ROADMAP:
                with quiet():
                    planner.growRoadmapPtc(end_of_slice(self.budget))
                if planner.milestoneCount() < _GROWN * looked and not self.budget.exhausted:
                    continue
                looked = planner.milestoneCount()
                poses = self._over_roadmap(si, planner, curves)
            else:
                poses = self._slice(planner, definition)
            if poses is not None and not np.array_equal(poses, before):
                before = poses
                yield self._path(poses, curves)

    def _slice(self, planner: ob.Planner, definition: ob.ProblemDefinition) -> Float[Array, "pose 3"] | None:
        with quiet():
            planner.solve(end_of_slice(self.budget))
            poses = None
            if definition.hasExactSolution():
                poses = np.array([_pose(state) for state in definition.getSolutionPath().getStates()])
            definition.clearSolutionPaths()
        return poses

    def _over_roadmap(self, si: ob.SpaceInformation, planner: og.PRM, curves: _Curves) -> Float[Array, "pose 3"] | None:
        """Return the poses of the shortest path over the roadmap after connecting both ends to it."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        data = ob.PlannerData(si)
        planner.getPlannerData(data)
        n = data.numVertices()
        poses = np.array([*(_pose(data.getVertex(i).getState()) for i in range(n)), *self._ends()])
        edges = [(i, j) for i in range(n) for j in data.getEdges(i) if i < j]
        for end in range(n, len(poses)):
            length = shortest_curves(poses[end], poses[:-1] if end == n else poses[:n], curves.steering).cost
            near = [int(k) for k in np.argsort(length, kind="stable")[: _JOINED + 1] if k != end]
            edges += [(k, end) for k in near if curves.free(tuple(poses[k].tolist()), tuple(poses[end].tolist()))]
        if not edges:
            return None
        tail, head = np.array(edges).T
        length = shortest_curves(poses[tail], poses[head], curves.steering).cost
        graph = coo_array((length, (tail, head)), shape=(len(poses), len(poses))).tocsr()
        cost, before = dijkstra(graph, directed=False, indices=n, return_predecessors=True)
        goal = n + 1 + int(np.argmin(cost[n + 1 :]))
        if not np.isfinite(cost[goal]):
            return None
        way = [goal]
        while way[-1] != n:
            way.append(int(before[way[-1]]))
        return poses[way[::-1]]

    def _ends(self) -> list[Pose]:
        turned = np.remainder(np.array([self.start, *self.goals])[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        return [
            (float(q[0]), float(q[1]), float(yaw)) for q, yaw in zip([self.start, *self.goals], turned, strict=True)
        ]

    def _bounds(self, around: float) -> ob.RealVectorBounds:
        bounds, ends = ob.RealVectorBounds(2), np.concatenate([self.start[None], self.goals])[:, :2]
        for i in range(2):
            bounds.setLow(i, float(max(self.problem.lower[i], ends[:, i].min() - around)))
            bounds.setHigh(i, float(min(self.problem.upper[i], ends[:, i].max() + around)))
        return bounds

    def _definition(self, si: ob.SpaceInformation, curves: _Curves) -> ob.ProblemDefinition:
        definition, goals = ob.ProblemDefinition(si), ob.GoalStates(si)
        for k, pose in enumerate(self._ends()):
            state = si.allocState()
            state.setX(pose[0])
            state.setY(pose[1])
            state.setYaw(pose[2])
            if k == 0:
                definition.addStartState(state)
            else:
                goals.addState(state)
        definition.setGoal(goals)
        definition.setOptimizationObjective(_CurveObjective(si, curves))
        return definition

    def _path(self, poses: Float[Array, "pose 3"], curves: _Curves) -> Float[Array, "vertex nq"]:
        parts = [self.start[None]]
        for a, b in zip(poses[:-1].tolist(), poses[1:].tolist(), strict=True):
            part = curves.chords(tuple(a), tuple(b)).copy()
            # Headings are continuous beyond pi from one curve to the next.
            part[:, 2] += 2.0 * np.pi * np.round((parts[-1][-1, 2] - part[0, 2]) / (2.0 * np.pi))
            parts.append(part)
        q = np.concatenate(parts)
        here = np.abs(self.goals[:, :2] - q[-1, :2]).max(axis=1) < 1e-6
        goals = self.goals[here] if here.any() else self.goals
        return np.concatenate([q, goals[np.argmin(np.abs(goals[:, 2] - q[-1, 2]))][None]])


def _pose(state: ob.SE2StateType) -> Pose:
    return state.getX(), state.getY(), state.getYaw()


class _Curves:
    """Curves between poses as straight stretches and small turns in place: collision checks and costs."""

    def __init__(
        self, problem: Problem, objective: BoundObjective, steering: Steering, start: Float[Array, " nq"]
    ) -> None:
        self.problem, self.objective, self.steering, self.start = problem, objective, steering, start
        length = isinstance(objective, SceneObjective) and objective.motion_is_length
        self.by_length = length and objective.w == 0.0
        self.spacing = min(_CHORD, _TURN * steering.radius)
        self.chords = lru_cache(_KEPT_CURVES)(self._chords)
        self.free = lru_cache(_KEPT_CURVES)(self._free)
        self.cost = lru_cache(_KEPT_CURVES)(self._cost)

    def state_free(self, pose: Pose) -> bool:
        return bool(self.problem.states_free(np.concatenate([pose, self.start[3:]])[None])[0])

    def _free(self, a: Pose, b: Pose) -> bool:
        q = self.chords(a, b)
        return bool(self.problem.edges_free(q[:-1], q[1:]).all())

    def _cost(self, a: Pose, b: Pose) -> float:
        if self.by_length:
            metres, curvature = np.abs(shortest_curves(np.array(a), np.array(b), self.steering).pieces[:, :2]).T
            return float((metres * (1.0 + curvature)).sum())
        q = self.chords(a, b)
        return float(checked_costs(self.objective, "edge costs", edge_totals(self.objective, q[:-1], q[1:])).sum())

    def _chords(self, a: Pose, b: Pose) -> Float[Array, "vertex nq"]:
        poses = shortest_curves(np.array(a), np.array(b), self.steering).sampled(self.spacing)
        way = np.diff(poses[:, :2], axis=0)
        middle = 0.5 * (poses[:-1, 2] + poses[1:, 2])
        gear = np.where(way[:, 0] * np.cos(middle) + way[:, 1] * np.sin(middle) >= 0.0, 1.0, -1.0)
        heading = np.arctan2(gear * way[:, 1], gear * way[:, 0])
        heading = middle + np.remainder(heading - middle + np.pi, 2.0 * np.pi) - np.pi
        still = np.abs(way).max(axis=1, initial=0.0) < 1e-9
        heading = np.where(still, middle, heading)
        q = np.tile(self.start, (2 * len(way) + 2, 1))
        q[0, :3], q[-1, :3] = poses[0], poses[-1]
        q[1:-1:2, :2], q[2:-1:2, :2] = poses[:-1, :2], poses[1:, :2]
        q[1:-1:2, 2] = q[2:-1:2, 2] = heading
        same = np.append(False, np.abs(np.diff(q, axis=0)).max(axis=1) < 1e-12)
        return q[~same] if (~same).sum() > 1 else q[:2]


@final
class _CurveValidator(ob.MotionValidator):
    """Checks the chords of a motion in one batch."""

    def __init__(self, si: ob.SpaceInformation, curves: _Curves) -> None:
        super().__init__(si)
        self._curves = curves

    def checkMotion(self, s0: ob.State, s1: ob.State) -> bool:
        return self._curves.free(_pose(s0), _pose(s1))


@final
class _CurveObjective(ob.OptimizationObjective):
    """J of curves."""

    def __init__(self, si: ob.SpaceInformation, curves: _Curves) -> None:
        super().__init__(si)
        self._curves = curves

    def isSymmetric(self) -> bool:
        return self._curves.objective.w == 0.0  # the impact of a failing base depends on its direction

    def stateCost(self, s: ob.State) -> ob.Cost:
        return ob.Cost(0.0)

    def motionCost(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        return ob.Cost(self._curves.cost(_pose(s0), _pose(s1)))

    def motionCostHeuristic(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        return ob.Cost(0.0)

    def motionCostBestEstimate(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        return self.motionCostHeuristic(s0, s1)

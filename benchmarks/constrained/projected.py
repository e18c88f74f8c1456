"""First paths under a constraint: by projection, by rejection with the same kernels, and by OMPL's projected space."""

from __future__ import annotations

import time
from typing import final

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from graceful_plan.constraints.bounds import frame_in_link
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import COST_STEP, FINE_STEP, Kernels
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.planners import RRTConnect
from graceful_plan.planners.native import run_slice
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.scene.rules.rules import AxisRule
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_NUDGE = 1e-5
"""Step of central differences [rad]."""


def connect(problem: SceneProblem, objective: SceneObjective, seed: int, seconds: float, *, projects: bool) -> float:
    """Return the time of RRT-Connect to its first path [s]; infinite without one in time."""
    kernel, settings, budget = objective.kernel, RRTConnect(), Budget(seconds)
    assert kernel is not None
    started = time.perf_counter()
    space = _native.SceneSpace(
        core=problem.kernels.core,
        impact=kernel.native,
        lower=problem.lower,
        upper=problem.upper,
        w=objective.w,
        check_step=problem.check_step,
        fine_step=FINE_STEP,
        cost_step=COST_STEP,
        margin=problem.margin,
        projects=projects,
    )
    core = _native.Connect(
        space,
        start=problem.start,
        goals=problem.goals,
        range=settings.range * problem.extent,
        max_nodes=settings.max_nodes,
        seed=seed,
    )
    while not budget.exhausted:
        if run_slice(core.run, budget):
            return time.perf_counter() - started
    return np.inf


@final
class Outside(ob.Constraint):
    """Distance of a configuration from the constraint, 0 inside, since OMPL only projects onto equations."""

    def __init__(self, rule: AxisRule, scene: Scene) -> None:
        super().__init__(len(scene.joints), 1)
        compiled = compile_scene(scene)
        self._kernels, self._link = compiled.kernels, compiled.robot.tool_link
        self._axis = frame_in_link(scene, compiled.robot, rule.frame)[:3, :3] @ rule.axis
        self._direction, self._angle = np.array(rule.direction), rule.angle

    def function(self, x: Array, out: Array) -> None:
        """Write the distance of a configuration from the constraint [rad]."""
        out[0] = max(0.0, float(self.residual(np.array(x)[None])[0]))

    def jacobian(self, x: Array, out: Array) -> None:
        """Write the derivative of the distance, 0 inside."""
        n = len(x)
        around = np.array(x) + _NUDGE * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
        residual = self.residual(around)
        slope = (residual[1 : 1 + n] - residual[1 + n :]) / (2.0 * _NUDGE)
        out[0, :] = slope if residual[0] > 0.0 else 0.0

    def residual(self, q: Array) -> Array:
        """Return the excess of the angle [rad]."""
        axis = self._kernels.link_poses(q)[:, self._link, :3, :3] @ self._axis
        across = np.linalg.norm(np.cross(axis, self._direction), axis=1)
        return np.arctan2(across, axis @ self._direction) - self._angle


def ompl_connect(problem: SceneProblem, rule: AxisRule, scene: Scene, seed: int, seconds: float) -> float:
    """Return the time to a first path of RRT-Connect in OMPL's ProjectedStateSpace [s]; infinite without one."""
    kernels, n, budget = compile_scene(scene).kernels, len(problem.start), Budget(seconds)
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed + 1)
    bounds = ob.RealVectorBounds(n)
    for i, (low, high) in enumerate(zip(problem.lower, problem.upper, strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    ambient = ob.RealVectorStateSpace(n)
    ambient.setBounds(bounds)
    outside = Outside(rule, scene)
    space = ob.ProjectedStateSpace(ambient, outside)
    information = ob.ConstrainedSpaceInformation(space)
    # The bounds are those of the ambient space, which projection may leave.
    information.setStateValidityChecker(lambda s: _valid(np.array([[s[i] for i in range(n)]]), problem, kernels))
    information.setup()
    definition, goals = ob.ProblemDefinition(information), ob.GoalStates(information)
    definition.addStartState(_state(information, problem.start))
    for goal in problem.goals:
        goals.addState(_state(information, goal))
    definition.setGoal(goals)
    planner = og.RRTConnect(information)
    planner.setProblemDefinition(definition)
    planner.setup()
    started = time.perf_counter()
    planner.solve(ob.PlannerTerminationCondition(lambda: budget.exhausted))
    taken = time.perf_counter() - started
    return taken if definition.hasExactSolution() and taken <= seconds else np.inf


def _valid(q: Array, problem: SceneProblem, kernels: Kernels) -> bool:
    inside = bool(np.all(q >= problem.lower) and np.all(q <= problem.upper))
    return inside and bool(kernels.free(q, problem.margin)[0])


def _state(information: ob.SpaceInformation, q: Array) -> ob.State:
    state = information.allocState()
    state.copy([float(x) for x in q])
    return state

"""Inputs of roadmap growth from a scene: free space, costs, and endpoints of motions."""

from __future__ import annotations

import os
from collections.abc import Iterable

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.costs.objective import Objective
from graceful_plan.planners.roadmaps.growth import Ground
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.endpoints import Endpoints, find_endpoints
from graceful_plan.query.endpoints.goals import Goal
from graceful_plan.roadmap.answers import QueryResult, QueryStatus
from graceful_plan.roadmap.exposure import Exposure
from graceful_plan.scene.scene import Scene

Motion = tuple[Configuration, Goal]
"""A start and a goal, as for `plan`."""

MARGIN = 0.002
"""Clearance that nodes and edges keep [m]."""
_MOST_PAIRS = 24


def problem_of(constraints: SceneConstraints, margin: float = MARGIN) -> SceneProblem:
    """Return a problem for checking states and edges at a fine step; it has no goals and a placeholder start."""
    n = len(constraints.scene.joints)
    return SceneProblem(
        kernels=constraints.kernels,
        start=np.zeros(n),
        goals=np.zeros((0, n)),
        check_step=FINE_STEP,
        margin=margin,
        constraints=constraints,
    )


def ground_of(exposure: Exposure, constraints: SceneConstraints) -> Ground:
    """Return the inputs of roadmap growth in a scene."""
    scene, problem = exposure.scene, problem_of(constraints)
    objective = exposure.objective.bind(scene, exposure.paces)
    native = objective.kernel is not None and not constraints.custom
    return Ground(
        problem=problem,
        impact=objective.states,
        price=exposure.price,
        severity=exposure.severity(scene),
        threads=(os.cpu_count() or 1) if native else 1,  # custom costs and constraints may not be thread-safe
    )


def declared_motions(scene: Scene) -> list[Motion]:
    """Return the motions that a scene declares: tasks with the held object; if there are none, all keyframe pairs."""
    held = None if scene.notes.held is None else scene.notes.held.body
    found: list[Motion] = []
    for task in scene.tasks.values():
        body = None if task.object_name is None else scene.notes.objects[task.object_name].body
        if body == held:
            found.append((task.start, task.goal))
    return found or [(a, b) for a in scene.keyframes for b in scene.keyframes if a != b]


def usable_pairs(
    motions: Iterable[Motion], constraints: SceneConstraints, rng: np.random.Generator
) -> Float[Array, "pair 2 nq"]:
    """Return planner starts and goals of these motions; motions whose ends have no clearance are skipped."""
    pairs: list[Array] = []
    for start, goal in motions:
        ends = find_endpoints(start, goal, constraints, rng)
        if isinstance(ends, Endpoints):
            pairs += [np.stack([ends.departure.q[-1], arrival.q[0]]) for arrival in ends.arrivals]
    found = np.array(pairs).reshape(-1, 2, len(constraints.scene.joints))
    free = problem_of(constraints).states_free(found.reshape(-1, found.shape[-1])).reshape(-1, 2)
    usable = free.all(axis=1) & np.any(found[:, 0] != found[:, 1], axis=1)
    return rng.permutation(found[usable])[:_MOST_PAIRS]


def usable_ends(
    start: Configuration,
    goal: Goal,
    constraints: SceneConstraints,
    rng: np.random.Generator,
    objective: Objective,
    seed: int = 0,
) -> Endpoints | QueryResult:
    """Return both ends of a motion, or a query result with the reason why there are none.

    Raises:
        GracefulPlanError: For misuse, as for `plan`.
    """
    ends = find_endpoints(start, goal, constraints, rng, objective=objective.bind(constraints.scene), seed=seed)
    if isinstance(ends, Endpoints):
        return ends
    return QueryResult(status=QueryStatus[ends.status.name], detail=ends.detail)

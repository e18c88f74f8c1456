"""Paths of different kinds for one start and goal: a small roadmap's front of motion against impact.

Cheap beginnings for local optimisers, which never leave the class of path that they begin in.
"""

from __future__ import annotations

import os

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Problem
from graceful_plan.planners.roadmaps.edge_prices import EdgePrices
from graceful_plan.planners.roadmaps.graph import Graph, non_dominated, spread_out
from graceful_plan.planners.roadmaps.growth import Ground, Growth

Array = np.ndarray

COARSE_STEP = 0.1
"""Largest joint-space distance between samples of the impact along an edge [rad], where the objective can be told."""
_EPSILON = 0.02
_NEIGHBOURS = 6


def roadmap_seeds(
    problem: Problem,
    objective: BoundObjective,
    rng: np.random.Generator,
    *,
    nodes: int = 200,
    most: int = 6,
    deadline: float = np.inf,
) -> list[Path]:
    """Grow a small roadmap between the start and the goals, and return paths spread over its front.

    Args:
        problem: Start and goals; edges are as free as it says.
        objective: The cost.
        rng: Source of all random numbers.
        nodes: Size of the roadmap.
        most: How many paths to return at most.
        deadline: Reading of `time.perf_counter` at which to stop growing [s].

    Returns:
        The cheapest path of the roadmap first, the others by total cost; nothing if it is not connected.
    """
    pairs = np.stack([np.stack([problem.start, goal]) for goal in problem.goals])
    weights = tuple(dict.fromkeys(objective.w * factor for factor in (0.0, 0.25, 1.0, 4.0)))
    growth = Growth(_ground(problem, objective), pairs, _NEIGHBOURS, rng, deadline, weights)
    growth.grow(nodes)
    edges = growth.edges
    cost = np.stack([edges.prices.motion, edges.prices.impact(np.ones(1))], axis=1)
    front = Graph(len(growth.q), edges.tail, edges.head).front(
        cost, int(growth.pairs[0, 0]), np.unique(growth.pairs[:, 1]), _EPSILON
    )
    total = front.cost @ (1.0, objective.w)
    if len(total) == 0:
        return []
    chosen = spread_out(front.cost, non_dominated(front.cost), most - 1)
    chosen = np.union1d(chosen, np.argmin(total))
    found = [front.edges[k] for k in chosen[np.argsort(total[chosen], kind="stable")]]
    return [Path(growth.q[np.append(edges.tail[steps[:1]], edges.head[steps])]) for steps in found if len(steps)]


def _ground(problem: Problem, objective: BoundObjective) -> Ground:
    kernel = objective.kernel if isinstance(objective, SceneObjective) else None

    def price(q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> EdgePrices:
        cost = objective.edges(q0, q1) if kernel is None else kernel.edges(q0, q1, COARSE_STEP)
        return EdgePrices.of(cost[:, 0].copy(), cost[:, 1:])

    return Ground(
        lower=np.asarray(problem.lower),
        upper=np.asarray(problem.upper),
        states_free=problem.states_free,
        edges_free=problem.edges_free,
        impact=objective.states,
        price=price,
        severity=np.ones(1),
        threads=1 if kernel is None else os.cpu_count() or 1,
    )

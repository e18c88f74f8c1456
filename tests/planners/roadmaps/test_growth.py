"""Growing roadmaps on problems without a robot, and the fronts of small roadmaps."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from saddles import saddle

from graceful_plan.compare.problems.analytic import analytic_problems
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.path import Path
from graceful_plan.planners.planner import path_total
from graceful_plan.planners.roadmaps.edge_prices import EdgeCosts, Edges, symmetric
from graceful_plan.planners.roadmaps.graph import Graph
from graceful_plan.planners.roadmaps.growth import Ground, Growth, nearest
from sizes import first_quick


def _columns(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return cost[:, 0].copy(), cost[:, 1:]


def front_of_roadmap(problem, objective, rng, *, nodes=200, deadline=np.inf) -> list[Path]:
    """Grow a small roadmap between start and goals; return the paths of its front, the cheapest first."""
    ground = Ground(
        problem=problem,
        impact=objective.states,
        price=lambda q0, q1: EdgeCosts.of(*_columns(objective.edges(q0, q1))),
        severity=np.ones(1),
    )
    pairs = np.stack([np.stack([problem.start, goal]) for goal in problem.goals])
    growth = Growth(ground, pairs, 6, rng, deadline)
    growth.grow(nodes)
    edges = growth.edges
    cost = np.stack([edges.prices.motion, edges.prices.impact(np.ones(1))], axis=1)
    graph = Graph(len(growth.q), edges.tail, edges.head)
    front = graph.front(cost, int(growth.pairs[0, 0]), np.unique(growth.pairs[:, 1]), epsilon=0.02)
    paths = [Path(growth.q[np.append(edges.tail[steps[:1]], edges.head[steps])]) for steps in front.edges]
    return [paths[k] for k in np.argsort(front.cost @ (1.0, objective.w), kind="stable")]


@given(st.integers(1, 40), st.integers(1, 12), st.integers(0, 1000))
def test_nearest_equals_a_full_sort(n, k, seed):
    rng = np.random.default_rng(seed)
    nodes, q = rng.uniform(size=(n, 3)), rng.uniform(size=(7, 3))
    expected = np.argsort(np.linalg.norm(q[:, None] - nodes, axis=2), axis=1)[:, :k]
    assert nearest(q, nodes, k).tolist() == expected.tolist()


def test_nearest_of_nothing():
    assert nearest(np.zeros((3, 2)), np.zeros((0, 2)), 4).shape == (3, 0)
    assert nearest(np.zeros((0, 2)), np.zeros((5, 2)), 4).shape == (0, 4)


def test_prices_add_up_by_severity():
    first = EdgeCosts.of(np.array([1.0, 2.0]), np.array([[0.0, 3.0], [0.5, 0.0]]))
    second = EdgeCosts.of(np.array([4.0]), np.array([[1.0, 1.0]]))
    both = EdgeCosts.concatenated([first, second])
    assert len(both.exposure) == 4  # zeros are not stored
    assert both.motion.tolist() == [1.0, 2.0, 4.0]
    assert both.impact(np.array([10.0, 1.0])).tolist() == [3.0, 5.0, 11.0]
    assert both.impact(np.zeros(2)).tolist() == [0.0] * 3
    nothing = EdgeCosts.concatenated([])
    assert nothing.impact(np.ones(2)).shape == (0,)
    assert len(Edges.concatenated([])) == 0


def test_a_price_that_differs_by_direction_is_noticed():
    def uphill(q0: np.ndarray, q1: np.ndarray) -> EdgeCosts:
        return EdgeCosts.of(np.linalg.norm(q1 - q0, axis=1), np.maximum(0.0, q1[:, :1] - q0[:, :1]))

    def flat(q0: np.ndarray, q1: np.ndarray) -> EdgeCosts:
        return EdgeCosts.of(np.linalg.norm(q1 - q0, axis=1), np.abs(q1[:, :1] - q0[:, :1]))

    q = np.random.default_rng(0).uniform(size=(2, 9, 2))

    def nothing(q0: np.ndarray, q1: np.ndarray) -> EdgeCosts:
        return EdgeCosts.of(np.linalg.norm(q1 - q0, axis=1), np.zeros((len(q0), 1)))

    assert symmetric(flat, *q) is True and symmetric(uphill, *q) is False
    assert symmetric(nothing, *q) is None and symmetric(flat, *q[:, :3]) is None


@pytest.mark.parametrize("name", sorted(analytic_problems()))
@pytest.mark.parametrize("seed", first_quick([0, 1]))
def test_fronts_come_close_to_known_optima(name, seed):
    instance = analytic_problems()[name]
    paths = front_of_roadmap(instance.problem, instance.objective, np.random.default_rng(seed), nodes=250)
    totals = [path_total(instance.objective, path) for path in paths]
    assert totals == pytest.approx(sorted(totals))
    assert instance.optimum * (1.0 - 1e-3) < totals[0] < 1.04 * instance.optimum
    for path in paths:
        np.testing.assert_array_equal(path.q[[0, -1]], [instance.problem.start, instance.problem.goals[0]])
        assert instance.problem.edges_free(path.q[:-1], path.q[1:]).all()


def test_paths_are_of_different_kinds():
    case = saddle(scale=3.0)
    paths = front_of_roadmap(case.problem, case.objective, np.random.default_rng(0), nodes=300)
    highest = [path.resampled(0.05).q[:, 1].max() for path in paths]
    assert min(highest) < 0.4 and max(highest) > 0.7  # one over the ridge, one through the pass


def test_roadmaps_depend_on_the_generator_alone():
    instance = analytic_problems()["two_media"]
    first, again, other = (
        front_of_roadmap(instance.problem, instance.objective, np.random.default_rng(seed), nodes=80)
        for seed in (1, 1, 2)
    )
    assert [p.q.tolist() for p in first] == [p.q.tolist() for p in again]
    assert [p.q.tolist() for p in first] != [p.q.tolist() for p in other]


def test_paths_around_a_wall():
    problem = FunctionProblem(
        start=np.array([-1.0, 0.0]),
        goals=np.array([[1.0, 0.0], [-1.0, -0.5]]),
        lower=np.full(2, -2.0),
        upper=np.full(2, 2.0),
        free=lambda q: np.abs(q[:, 0]) > 0.1,
    )
    objective = DensityObjective(density=lambda q: np.zeros(len(q)))
    paths = front_of_roadmap(problem, objective, np.random.default_rng(0), nodes=60)
    assert paths and all(np.array_equal(path.q[-1], problem.goals[1]) for path in paths)
    beyond = FunctionProblem(
        start=problem.start, goals=problem.goals[:1], lower=problem.lower, upper=problem.upper, free=problem.free
    )
    assert front_of_roadmap(beyond, objective, np.random.default_rng(0), nodes=60) == []
    full = FunctionProblem(
        start=problem.start,
        goals=problem.goals[:1],
        lower=problem.lower,
        upper=problem.upper,
        free=lambda q: np.zeros(len(q), dtype=bool),
    )
    assert front_of_roadmap(full, objective, np.random.default_rng(0), nodes=60) == []


def test_without_time_nothing_is_added():
    instance = analytic_problems()["disc"]
    late = time.perf_counter() - 1.0
    assert front_of_roadmap(instance.problem, instance.objective, np.random.default_rng(0), deadline=late) == []


def test_a_deadline_leaves_complete_parts():
    asked: list[int] = []

    def price(q0: np.ndarray, q1: np.ndarray) -> EdgeCosts:
        asked.append(len(q0))
        if len(asked) > 20:
            growth.deadline = 0.0
        return EdgeCosts.of(np.linalg.norm(q1 - q0, axis=1), np.zeros((len(q0), 1)))

    ground = Ground(
        problem=FunctionProblem(start=np.zeros(2), goals=np.ones((1, 2)), lower=np.zeros(2), upper=np.ones(2)),
        impact=lambda q: np.zeros(len(q)),
        price=price,
        severity=np.ones(1),
    )
    growth = Growth(ground, np.zeros((0, 2, 2)), 5, np.random.default_rng(0))
    growth.grow(2000)
    edges = growth.edges
    assert 0 < len(growth.q) < 2000
    assert edges.tail.max() < len(growth.q) and edges.head.max() < len(growth.q)
    assert set(range(len(growth.q))) == set(edges.tail.tolist())

"""Every planner of the registry: the contract, known optima, and shared laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.compare.problems.analytic import analytic_problems, disc, free_space, two_media
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.exceptions import CostError, SettingError
from graceful_plan.path import Path
from graceful_plan.planners import PLANNERS, PRM, RRT, BITStar, InformedRRTStar, PRMStar, RRTConnect, RRTStar
from graceful_plan.planners.informed import InformedSampler, probe_objective
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem
from graceful_plan.planners.planner import Budget, Planner, Problem, path_total
from graceful_plan.planners.roadmaps.lazy_roadmap import LazyRoadmap
from graceful_plan.testing import PlannerTrial, check_planner

_NAMES = (
    "auto", "anytime", "rrt_connect", "prm", "prm_star", "trrt", "bitrrt", "tool_rrt", "rrt", "rrt_star",
    "informed_rrt_star", "bit_star", "stomp", "chomp", "casadi",
)  # fmt: skip

_ITERATIONS = {
    "auto": 80, "anytime": 80, "chomp": 100, "stomp": 80, "casadi": 25, "prm": 120, "prm_star": 100, "rrt_star": 100,
    "informed_rrt_star": 100, "trrt": 400,
}  # fmt: skip
"""Iterations that are ample in the plane; an iteration differs from planner to planner."""

_HASTY = {"bit_star": {"samples_per_batch": 40}}
"""Settings for few iterations."""

_TOLERANCE = 1.05
"""J / J* allowed at the moderate budgets of these tests; the benchmark has more time and requires 1.02."""


def _last(planner: Planner, problem: Problem, objective, iterations: int, seed: int = 0) -> float:
    paths = list(planner.solve(problem, objective, Budget(iterations=iterations), np.random.default_rng(seed)))
    return path_total(objective, paths[-1]) if paths else np.inf


def test_registry_holds_every_planner_under_its_name() -> None:
    assert set(PLANNERS) == set(_NAMES)
    assert all(PLANNERS[name].name == name for name in _NAMES)


@pytest.mark.parametrize("name", _NAMES)
def test_contract(name: str) -> None:
    """The overrun is large because the test machine may be busy, and type checks slow every call."""
    planner = PLANNERS[name](**_HASTY.get(name, {}))
    check_planner(planner, PlannerTrial(iterations=_ITERATIONS.get(name, 250), time_limit=0.02, overrun=10.0))


@pytest.mark.long
@pytest.mark.parametrize("instance", analytic_problems().values(), ids=list(analytic_problems()))
@pytest.mark.parametrize(
    ("planner", "iterations"),
    [(PRMStar(shortcut=False), 700), (PRMStar(), 300), (RRTStar(), 400), (InformedRRTStar(), 400), (BITStar(), 900)],
    ids=["prm_star-pure", "prm_star", "rrt_star", "informed_rrt_star", "bit_star"],
)
def test_optimal_planners_come_close_to_the_optimum(planner: Planner, iterations: int, instance) -> None:
    ratio = _last(planner, instance.problem, instance.objective, iterations) / instance.optimum
    assert 0.995 <= ratio <= _TOLERANCE


@pytest.mark.parametrize("name", ["prm", "trrt", "bitrrt", "rrt"])
def test_feasible_planners_shortcut_their_paths(name: str) -> None:
    instance = disc()
    assert _last(PLANNERS[name](), instance.problem, instance.objective, 800) <= _TOLERANCE * instance.optimum
    raw = PLANNERS[name](shortcut=False)  # pyright: ignore[reportCallIssue]
    paths = list(raw.solve(instance.problem, instance.objective, Budget(iterations=1500), np.random.default_rng(0)))
    assert len(paths) == 1


@pytest.mark.parametrize(
    "planner", [PRMStar(), BITStar(), RRTStar(), InformedRRTStar()], ids=lambda planner: planner.name
)
def test_a_free_straight_line_is_recognised_as_optimal(planner: Planner) -> None:
    """With w = 0 the straight line is optimal, so the planner stops long before its budget ends."""
    instance = free_space()
    budget = Budget(iterations=50_000)
    *_, path = planner.solve(
        instance.problem, DensityObjective(density=lambda q: q[:, 0] ** 2, w=0.0), budget, np.random.default_rng(0)
    )
    assert path.length == pytest.approx(instance.optimum)
    assert budget.spent < 50_000


@pytest.mark.parametrize("backwards", [False, True])
def test_trees_leave_a_narrow_slot(backwards: bool) -> None:
    """Either end may sit in a slot that is 50 times deeper than wide; the search extends both trees."""
    ends = np.array([[0.0, 0.0], [2.0, 1.5]])
    start, goal = ends[::-1] if backwards else ends
    problem = FunctionProblem(
        start=start,
        goals=goal[None],
        lower=np.array([-1.0, -2.0]),
        upper=np.array([3.0, 2.0]),
        free=lambda q: (q[:, 0] > 1.0) | (np.abs(q[:, 1]) < 0.01),
        step=0.005,
    )
    objective = DensityObjective(density=lambda q: np.zeros(len(q)), w=0.0)
    for seed in range(5):
        rng, budget = np.random.default_rng(seed), Budget(iterations=3000)
        assert next(iter(RRTConnect(shortcut=None).solve(problem, objective, budget, rng)), None) is not None


@pytest.mark.parametrize("seed", range(3))
def test_samples_near_trees_keep_limits_and_seeds(seed: int) -> None:
    """Both ends sit in corners, so many samples around them would be outside the limits."""
    problem = FunctionProblem(
        start=np.array([-1.0, -2.0]),
        goals=np.array([[3.0, 2.0]]),
        lower=np.array([-1.0, -2.0]),
        upper=np.array([3.0, 2.0]),
        free=lambda q: (np.abs(q[:, 0] - 1.0) > 0.2) | (q[:, 1] > 1.7) | (q[:, 1] < -1.7),
        step=0.02,
    )
    objective = DensityObjective(density=lambda q: np.zeros(len(q)), w=0.0)
    one, other = (
        next(iter(RRTConnect(shortcut=None).solve(problem, objective, Budget(iterations=3000), rng)))
        for rng in (np.random.default_rng(seed), np.random.default_rng(seed))
    )
    assert np.array_equal(one.q, other.q)
    assert np.all((one.q >= problem.lower) & (one.q <= problem.upper))


@pytest.mark.parametrize("seed", range(3))
def test_more_samples_never_make_a_roadmap_worse(seed: int) -> None:
    instance = two_media()
    planner = PRMStar(shortcut=False, informed=False)
    budgets = (60, 100, 170, 330)
    costs = [_last(planner, instance.problem, instance.objective, n, seed) for n in budgets]
    assert costs == sorted(costs, reverse=True)


def test_roadmap_restarts_around_its_best_path() -> None:
    instance = disc()
    planner = PRMStar(max_samples=150, shortcut=False)
    assert _last(planner, instance.problem, instance.objective, 1500) <= _TOLERANCE * instance.optimum


def _roadmap(n: int, seed: int, symmetric: bool = True) -> LazyRoadmap:
    problem = disc().problem
    objective = DensityObjective(density=lambda q: q[:, 1] ** 2, step=0.1)
    rng = np.random.default_rng(seed)
    roadmap = LazyRoadmap(
        InterruptibleProblem(problem, objective, Budget()),
        InformedSampler(problem, 1.0),
        symmetric,
        lambda i: np.full(len(i), 5),
    )
    q = rng.uniform(-3, 3, (n, 2))
    q = q[problem.states_free(q)]
    roadmap.add(q[: n // 3], np.inf)
    roadmap.add(q[n // 3 :], np.inf)
    return roadmap


@given(seed=st.integers(0, 1000), symmetric=st.booleans())
@settings(max_examples=10, deadline=None)
def test_lazy_query_equals_a_search_of_the_checked_graph(seed: int, symmetric: bool) -> None:
    roadmap = _roadmap(60, seed, symmetric)
    found = roadmap.cheapest(np.inf)
    problem, n = roadmap.questions.problem, len(roadmap)
    distance = np.full((n, n), np.inf)
    for i in range(1, n):
        for j in roadmap.earlier[roadmap.row_begin[i] : roadmap.row_begin[i + 1]]:
            a, b = roadmap.q[i : i + 1], roadmap.q[j : j + 1]
            if problem.edges_free(a, b)[0]:
                distance[i, j] = distance[j, i] = roadmap.questions.edge_costs(a, b)[0]
    for k in range(n):  # Floyd and Warshall's algorithm
        distance = np.minimum(distance, distance[:, k : k + 1] + distance[k : k + 1, :])
    expected = distance[0, 1 : 1 + roadmap.goal_count].min()
    assert (np.inf if found is None else found[0]) == pytest.approx(expected)
    assert roadmap.cheapest(expected * (1.0 - 1e-9)) is None


def test_nodes_are_joined_to_their_nearest_among_the_earlier() -> None:
    roadmap = _roadmap(50, 3)
    for i in range(2, len(roadmap)):
        joined = roadmap.earlier[roadmap.row_begin[i] : roadmap.row_begin[i + 1]]
        gaps = np.linalg.norm(roadmap.q[:i] - roadmap.q[i], axis=1)
        assert sorted(joined) == sorted(np.argsort(gaps, kind="stable")[: min(5, i)])


class _Motion:
    """V = weighted length, plus a cost of going up."""

    w = 1.0

    def __init__(self, weights: tuple[float, ...], uphill: float = 0.0) -> None:
        self._weights, self._uphill = np.array(weights), uphill

    def edges(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        climb = self._uphill * np.maximum(0.0, q1[:, 0] - q0[:, 0])
        return np.stack([np.linalg.norm((q1 - q0) * self._weights, axis=1), climb], axis=1)

    def states(self, q: np.ndarray) -> np.ndarray:
        return np.zeros(len(q))


@pytest.mark.parametrize(
    ("objective", "bound", "symmetric"),
    [
        (_Motion((1.0, 1.0)), 1.0, True),
        (_Motion((2.5, 2.5)), 2.5, True),
        (_Motion((1.0, 2.0)), 0.0, True),
        (_Motion((1.0, 1.0), uphill=1.0), 1.0, False),
        (_Motion((0.0, 0.0)), 0.0, True),
    ],
)
def test_bounds_on_an_objective_are_learned(objective: _Motion, bound: float, symmetric: bool) -> None:
    facts = probe_objective(objective, disc().problem)
    assert facts.length_bound == pytest.approx(bound, rel=1e-6)
    assert facts.length_bound <= bound
    assert facts.symmetric is symmetric


@given(seed=st.integers(0, 1000), dimension=st.integers(1, 7), slack=st.floats(1.001, 3.0), goals=st.integers(1, 3))
@settings(max_examples=40, deadline=None)
def test_informed_samples_can_be_on_a_better_path(seed: int, dimension: int, slack: float, goals: int) -> None:
    rng = np.random.default_rng(seed)
    lower, upper = np.full(dimension, -1.0), np.full(dimension, 2.0)
    ends = rng.uniform(lower, upper, (1 + goals, dimension))
    problem = FunctionProblem(start=ends[0], goals=ends[1:], lower=lower, upper=upper)
    sampler = InformedSampler(problem, 2.0)
    cost = sampler.least_cost * slack
    q = sampler.draw(30, cost, rng)
    assert len(q) <= 30
    assert np.all((q >= lower) & (q <= upper))
    assert np.all(sampler.bound_through(q) <= cost * (1.0 + 1e-9))
    low, high = sampler.box(cost)
    assert np.all((q >= low - 1e-9) & (q <= high + 1e-9))


def test_informed_samples_are_uniform() -> None:
    """Compared with rejection sampling: equal shares in the half nearer to the start, and near the long axis."""
    rng = np.random.default_rng(0)
    problem = FunctionProblem(
        start=np.array([-1.0, 0.0, 0.0]),
        goals=np.array([[1.0, 0.5, 0.0]]),
        lower=np.full(3, -9.0),
        upper=np.full(3, 9.0),
    )
    sampler = InformedSampler(problem, 1.0)
    drawn = sampler.draw(4000, 2.6, rng)
    box = rng.uniform(*sampler.box(2.6), (40_000, 3))
    rejected = box[sampler.bound_through(box) < 2.6]
    for statistic in (lambda q: q[:, 0] < -0.5, lambda q: np.abs(q[:, 2]) < 0.2, lambda q: np.abs(q[:, 1]) < 0.3):
        assert statistic(drawn).mean() == pytest.approx(statistic(rejected).mean(), abs=0.04)


def test_slices_answer_as_the_whole_does() -> None:
    instance = analytic_problems()["catenary"]
    rng = np.random.default_rng(0)
    q0, q1 = rng.uniform([-2, 1], [2, 3], (1500, 2)), rng.uniform([-2, 1], [2, 3], (1500, 2))
    fixed, timed = (
        InterruptibleProblem(instance.problem, instance.objective, Budget(time_limit=limit))
        for limit in (np.inf, 600.0)
    )
    whole = instance.objective.edges(q0, q1).sum(axis=1)
    np.testing.assert_allclose(fixed.edge_costs(q0, q1), whole, rtol=1e-12)
    np.testing.assert_allclose(timed.edge_costs(q0, q1), whole, rtol=1e-12)
    assert timed.edges_free(q0, q1).all()
    assert not timed.states_free(np.array([[0.0, 0.5], [9.0, 2.0]])).any()


@pytest.mark.parametrize("budget", [Budget(time_limit=0.0), Budget(cancelled=lambda: True)])
def test_questions_are_interrupted(budget: Budget) -> None:
    instance = disc()
    q = np.zeros((3, 2))
    with pytest.raises(Interrupted):
        InterruptibleProblem(instance.problem, instance.objective, budget).edge_costs(q, q)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
@pytest.mark.parametrize("name", ["prm", "prm_star", "rrt_star", "bit_star", "trrt"])
def test_a_broken_objective_is_named(name: str, value: float) -> None:
    objective = DensityObjective(density=lambda q: np.full(len(q), value))
    with pytest.raises(CostError, match=r"DensityObjective: (edge|state)"):
        _last(PLANNERS[name](), disc().problem, objective, 500)


def test_ompl_console_output_is_silenced_only_while_planning() -> None:
    from ompl import util as ou

    before = ou.getLogLevel()
    _last(RRT(shortcut=False), disc().problem, disc().objective, 50)
    assert ou.getLogLevel() == before


@pytest.mark.parametrize("name", _NAMES)
def test_a_start_at_a_goal_gives_a_path_without_length(name: str) -> None:
    inner = free_space().problem
    goals = np.stack([inner.goals[0], inner.start])
    problem = FunctionProblem(start=inner.start, goals=goals, lower=inner.lower, upper=inner.upper)
    budget = Budget(iterations=0)
    (path,) = PLANNERS[name]().solve(problem, free_space().objective, budget, np.random.default_rng(0))
    np.testing.assert_array_equal(path.q, inner.start[None])
    assert budget.spent == 0


@pytest.mark.parametrize("goal", [(2.0, 0.0), (-2.0, 0.0)])
def test_a_path_starts_at_the_start_even_if_it_is_a_goal(goal: tuple[float, float]) -> None:
    inner = disc().problem
    problem = FunctionProblem(start=inner.start, goals=np.array([goal]), lower=inner.lower, upper=inner.upper)
    for planner in (PRM(shortcut=False), RRT(shortcut=False), BITStar()):
        *_, path = planner.solve(problem, disc().objective, Budget(iterations=300), np.random.default_rng(0))
        assert isinstance(path, Path)
        np.testing.assert_array_equal(path.q[0], problem.start)
        np.testing.assert_array_equal(path.q[-1], goal)


@pytest.mark.parametrize(
    ("planner", "name", "value"),
    [
        (PRM, "neighbours", 0),
        (PRM, "batch", 0),
        (PRM, "max_samples", 5),
        (PRMStar, "factor", 0.0),
        (PRMStar, "factor", np.inf),
        (RRT, "range", -1.0),
        (RRT, "goal_bias", 1.5),
        (BITStar, "samples_per_batch", 0),
    ],
)
def test_settings_are_checked(planner, name: str, value: float) -> None:
    with pytest.raises(SettingError, match=name):
        planner(**{name: value})

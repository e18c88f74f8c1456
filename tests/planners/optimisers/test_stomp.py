"""STOMP: known optima, the laws of its update, leaving obstacles, limits, and fixed end points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.compare.problems.analytic import analytic_problems, disc, two_media
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.exceptions import CostError, NonFiniteError, SettingError, ShapeError
from graceful_plan.path import Path, evenly
from graceful_plan.planners.optimisers.optimiser import joined_to_ends
from graceful_plan.planners.optimisers.rollouts import Rollouts, weights
from graceful_plan.planners.optimisers.stomp import STOMP
from graceful_plan.planners.planner import Budget, path_total
from graceful_plan.planners.scene_problem import SceneProblem
from sizes import first_quick

_DETOURS = {
    "free_space": [[-1.0, -1.0], [-1.5, 0.5], [0.5, 1.5], [0.5, 0.5]],
    "uniform_density": [[-1.0, -1.0], [-1.5, 0.5], [0.5, 1.5], [0.5, 0.5]],
    "disc": [[-2.0, 0.0], [-2.5, 2.0], [1.0, 2.8], [2.0, 0.0]],
    "two_media": [[0.0, 1.0], [-1.0, -1.0], [2.5, 0.5], [2.0, -1.0]],
    "hyperbolic": [[0.0, 0.5], [-0.3, 0.2], [0.5, 0.15], [1.0, 0.5]],
    "catenary": [[-1.0, 2.0], [-1.5, 2.8], [1.5, 2.8], [1.0, 2.0]],
}
_FREE = DensityObjective(density=lambda q: np.zeros(len(q)), step=0.1)


def _path(*q: object) -> Path:
    return Path(np.array(q, dtype=np.float64))


def _improve(path: Path, problem, objective, iterations: int = 150, seed: int = 0, **changed) -> list[Path]:
    budget = Budget(iterations=iterations)
    return list(STOMP(**changed).improve(path, problem, objective, budget, np.random.default_rng(seed)))


def _space(start: tuple[float, ...], goal: tuple[float, ...], limit: float = 3.0, **more) -> FunctionProblem:
    far = np.full(len(start), limit)
    return FunctionProblem(start=np.array(start), goals=np.array([goal]), lower=-far, upper=far, **more)


@pytest.mark.parametrize("name", _DETOURS)
@pytest.mark.parametrize("seed", first_quick(range(2)))
def test_reaches_known_optima_from_a_bad_path_of_the_right_class(name: str, seed: int) -> None:
    instance = analytic_problems()[name]
    begin = Path(np.array(_DETOURS[name]))
    assert path_total(instance.objective, begin) > 1.2 * instance.optimum
    coarse = replace(instance.objective, step=0.03)
    *_, last = _improve(begin, instance.problem, coarse, iterations=120, seed=seed)
    exact = replace(instance.objective, step=instance.objective.step / 20.0)
    assert 1.0 - 1e-4 <= path_total(exact, last) / instance.optimum <= 1.02


@pytest.mark.parametrize("build", first_quick([disc, two_media]))
def test_reaches_known_optima_in_seven_dimensions(build) -> None:
    instance = build(7)
    flat = np.array(_DETOURS[instance.name])
    begin = np.concatenate([flat, np.zeros((len(flat), 5))], axis=1)
    begin[1:-1, 2:] = 0.3
    *_, last = _improve(Path(begin), instance.problem, instance.objective, iterations=250)
    assert path_total(instance.objective, last) <= 1.08 * instance.optimum


@given(seed=st.integers(0, 10_000))
@settings(max_examples=8, deadline=None)
def test_every_path_is_cheaper_free_within_the_limits_and_keeps_its_ends(seed: int) -> None:
    instance = disc()
    begin = Path(np.array(_DETOURS["disc"]))
    last = path_total(instance.objective, begin)
    paths = _improve(begin, instance.problem, instance.objective, iterations=12, seed=seed)
    assert paths
    for path in paths:
        cost = path_total(instance.objective, path)
        assert cost < last
        assert instance.problem.edges_free(path.q[:-1], path.q[1:]).all()
        assert np.all((path.q >= instance.problem.lower) & (path.q <= instance.problem.upper))
        np.testing.assert_array_equal(path.q[[0, -1]], begin.q[[0, -1]])
        last = cost


def test_gets_out_of_an_obstacle() -> None:
    instance = disc()
    shallow = _path([-2, 0], [-0.8, 0.9], [0.8, 0.9], [2, 0])
    assert not instance.problem.edges_free(shallow.q[:-1], shallow.q[1:]).all()
    paths = _improve(shallow, instance.problem, replace(instance.objective, step=0.05), iterations=100)
    assert path_total(instance.objective, paths[-1]) <= 1.02 * instance.optimum
    assert path_total(instance.objective, paths[0]) > path_total(instance.objective, shallow)


def test_an_impassable_wall_yields_nothing() -> None:
    wall = _space((-1.0, 0.0), (1.0, 0.0), free=lambda q: np.abs(q[:, 0]) > 0.2)
    assert _improve(_path([-1, 0], [1, 0]), wall, _FREE, iterations=40) == []


def test_paths_bend_around_a_jump_of_the_cost() -> None:
    """A cost without any gradient: 0 or 5, and the straight line crosses the 5."""
    problem = _space((-2.0, 0.0), (2.0, 0.0))
    objective = DensityObjective(
        density=lambda q: np.where(np.linalg.norm(q - [0.0, -0.3], axis=1) < 0.6, 5.0, 0.0), step=0.03
    )
    straight = _path([-2, 0], [2, 0])
    *_, last = _improve(straight, problem, objective)
    assert path_total(objective, last) < 4.15 < path_total(objective, straight)


def test_nothing_but_the_straight_line_counts_at_weight_zero() -> None:
    problem = _space((-1.0, -1.0), (1.0, 1.0))
    objective = DensityObjective(density=lambda q: 9.0 * np.exp(-4.0 * (q**2).sum(axis=1)), w=0.0, step=0.1)
    *_, last = _improve(_path([-1, -1], [1.0, -1.0], [1, 1]), problem, objective, iterations=100)
    assert last.length == pytest.approx(np.sqrt(8.0), rel=1e-3)
    assert _improve(_path([-1, -1], [1, 1]), problem, objective, iterations=20) == []


def test_does_not_drift_where_everything_costs_the_same() -> None:
    class Nothing:
        w = 1.0

        def edges(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
            return np.zeros((len(q0), 2))

        def states(self, q: np.ndarray) -> np.ndarray:
            return np.zeros(len(q))

    assert _improve(_path([-1, 0], [0, 1], [1, 0]), _space((-1.0, 0.0), (1.0, 0.0)), Nothing(), iterations=40) == []


def test_twice_as_many_points_lead_to_the_same_cost() -> None:
    instance = analytic_problems()["catenary"]
    begin, objective = Path(np.array(_DETOURS["catenary"])), replace(instance.objective, step=0.03)
    *_, few = _improve(begin, instance.problem, objective)
    *_, many = _improve(begin, instance.problem, objective, points=64)
    assert len(many) == 66 and len(few) == 34
    assert path_total(objective, many) == pytest.approx(path_total(objective, few), rel=0.01)


def test_same_seed_same_paths() -> None:
    instance = disc()
    first, second = (
        _improve(Path(np.array(_DETOURS["disc"])), instance.problem, instance.objective, iterations=30, seed=5)
        for _ in range(2)
    )
    assert len(first) == len(second) > 3
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_the_scale_of_the_cost_changes_no_path() -> None:
    instance = disc()

    class Scaled:
        w = 1.0

        def edges(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
            return 1024.0 * instance.objective.edges(q0, q1)

        def states(self, q: np.ndarray) -> np.ndarray:
            return np.zeros(len(q))

    begin = Path(np.array(_DETOURS["disc"]))
    *_, plain = _improve(begin, instance.problem, instance.objective, iterations=20)
    *_, scaled = _improve(begin, instance.problem, Scaled(), iterations=20)
    np.testing.assert_array_equal(plain.q, scaled.q)


@pytest.mark.parametrize("goal", [(1.0, 1.0), (1.0, -1.0)])
def test_goals_on_the_limits(goal: tuple[float, float]) -> None:
    problem = _space((-1.0, -1.0), goal, limit=1.0)
    begin = _path([-1, -1], [-1, 1], [0.5, 0.9], goal)
    *_, last = _improve(begin, problem, _FREE, iterations=100)
    assert np.all(np.abs(last.q) <= 1.0)
    assert last.length == pytest.approx(np.linalg.norm(problem.goals[0] - problem.start), rel=2e-3)


def test_a_path_that_leaves_the_limits_comes_back() -> None:
    problem = _space((-1.0, 0.0), (1.0, 0.0), limit=1.0)
    paths = _improve(_path([-1, 0], [0, 2.5], [1, 0]), problem, _FREE, iterations=100)
    assert all(np.all(np.abs(path.q) <= 1.0) for path in paths)
    assert paths[-1].length == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("path", [_path([0.5, 0.5]), _path([0.5, 0.5], [0.5, 0.5])])
def test_a_path_without_length_stays(path: Path) -> None:
    assert _improve(path, _space((0.5, 0.5), (0.5, 0.5)), _FREE) == []


def test_nothing_without_a_budget_and_one_call_at_most_after_it_ends() -> None:
    instance = disc()
    begin = Path(np.array(_DETOURS["disc"]))
    assert _improve(begin, instance.problem, instance.objective, iterations=0) == []
    cancelled = Budget(iterations=100, cancelled=lambda: True)
    planner = STOMP()
    assert not list(planner.improve(begin, instance.problem, instance.objective, cancelled, np.random.default_rng(0)))


def test_an_iteration_is_one_batch_of_rollouts_and_one_path() -> None:
    instance = disc()
    asked: list[int] = []

    class Counted:
        w = instance.objective.w

        def edges(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
            asked.append(len(q0))
            return instance.objective.edges(q0, q1)

        def states(self, q: np.ndarray) -> np.ndarray:
            raise AssertionError("only edges are asked for")

    begin = Path(np.array(_DETOURS["disc"]))
    _improve(begin, instance.problem, Counted(), iterations=6, points=9, rollouts=5)
    assert asked == [3, 10] + 5 * [50, 10]


def test_starts_from_the_initial_path_if_one_is_given() -> None:
    instance = disc()
    below = Path(np.array(_DETOURS["disc"]) * [1.0, -1.0])
    planner = STOMP(initial=below)
    budget = Budget(iterations=60)
    *_, last = planner.solve(instance.problem, instance.objective, budget, np.random.default_rng(0))
    assert last.q[len(last) // 2, 1] < 0.0
    assert budget.spent == 60


def test_an_initial_path_is_joined_to_the_start_and_the_nearest_goal() -> None:
    problem = FunctionProblem(
        start=np.zeros(2), goals=np.array([[5.0, 0.0], [2.0, 2.0]]), lower=np.full(2, -9.0), upper=np.full(2, 9.0)
    )
    joined = joined_to_ends(np.array([[1.0, 0.0], [1.0, 2.0]]), problem)
    np.testing.assert_array_equal(joined.q, [[0, 0], [1, 0], [1, 2], [2, 2]])
    whole = _path([0, 0], [3, 1], [5, 0])
    np.testing.assert_array_equal(joined_to_ends(whole, problem).q, whole.q)
    *_, last = STOMP(initial=whole.q[1:2]).solve(problem, _FREE, Budget(iterations=40), np.random.default_rng(0))
    np.testing.assert_array_equal(last.q[[0, -1]], [[0, 0], [2, 2]])
    with pytest.raises(ShapeError, match="initial"):
        joined_to_ends(np.zeros((3, 4)), problem)
    with pytest.raises(NonFiniteError, match="initial"):
        joined_to_ends(np.full((3, 2), np.nan), problem)


@pytest.mark.parametrize("value", [np.nan, -1.0])
def test_a_broken_objective_is_named(value: float) -> None:
    objective = DensityObjective(density=lambda q: np.full(len(q), value))
    with pytest.raises(CostError, match=r"DensityObjective: .*>= 0"):
        _improve(Path(np.array(_DETOURS["disc"])), disc().problem, objective)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("points", 0),
        ("rollouts", 0),
        ("elites", -1),
        ("sharpness", 0.0),
        ("deviation", np.inf),
        ("reaches", ()),
        ("reaches", (0.5, 1.5)),
    ],
)
def test_settings_are_checked(name: str, value: object) -> None:
    with pytest.raises(SettingError, match=name):
        STOMP(**{name: value})  # pyright: ignore[reportArgumentType]


# --- weights ----------------------------------------------------------------------------------------------------------


def _batch(cost: np.ndarray, blocked: np.ndarray | None = None) -> Rollouts:
    k, edges = cost.shape
    return Rollouts(
        q=np.zeros((k, edges + 1, 1)), cost=cost, blocked=np.zeros(cost.shape, bool) if blocked is None else blocked
    )


@given(seed=st.integers(0, 10_000), k=st.integers(1, 8), n=st.integers(1, 12), share=st.floats(0.0, 1.0))
@example(seed=624, k=4, n=1, share=0.5)  # a single free path among costs of 1e8
@settings(max_examples=40, deadline=None)
def test_weights_sum_to_one_and_those_of_free_paths_are_the_greatest(seed: int, k: int, n: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    batch = _batch(rng.uniform(size=(k, n + 1)) * 10.0 ** rng.uniform(-9, 9), rng.uniform(size=(k, n + 1)) < share)
    spread = rng.uniform(0.01, 1.0, (n, n))
    weight = weights(batch, spread / spread.sum(axis=1, keepdims=True), 10.0)
    assert np.all((weight >= 0.0) & np.isfinite(weight))
    np.testing.assert_allclose(weight.sum(axis=0), 1.0)
    free = ~(batch.blocked[:, :-1] | batch.blocked[:, 1:])
    least, most = np.where(free, weight, np.inf).min(axis=0), np.where(free, 0.0, weight).max(axis=0)
    assert np.all(least >= most * (1.0 - 1e-9))


def test_weights_equal_those_of_the_paper() -> None:
    cost = np.array([[1.0, 3.0, 2.0], [3.0, 1.0, 4.0], [2.0, 2.0, 2.0]])
    at_points = 0.5 * (cost[:, 1:] + cost[:, :-1])
    score = (at_points - at_points.min(axis=0)) / np.ptp(at_points, axis=0).clip(1e-300)
    score[:, 0] = 0.0  # all candidates cost the same at this point
    expected = np.exp(-10.0 * score) / np.exp(-10.0 * score).sum(axis=0)
    np.testing.assert_allclose(weights(_batch(cost), np.eye(2), 10.0), expected)


def test_equal_costs_give_equal_weights() -> None:
    """The update is then the mean of the noise, which is unbiased."""
    weight = weights(_batch(np.full((5, 9), 3.0)), np.eye(8), 10.0)
    np.testing.assert_array_equal(weight, np.full((5, 8), 0.2))


def test_blocked_paths_count_less_than_any_that_is_free() -> None:
    cost = np.array([[1.0, 1.0], [5.0, 5.0], [3.0, 3.0]])
    blocked = np.array([[True, False], [False, False], [False, False]])
    weight = weights(_batch(cost, blocked), np.eye(1), 10.0)[:, 0]
    assert weight[0] < weight[1] < weight[2]
    only = weights(_batch(cost, np.ones((3, 2), bool)), np.eye(1), 10.0)[:, 0]
    assert only[0] > only[2] > only[1]  # if all candidates are blocked, the cost decides


def test_fewer_blocked_edges_rank_before_lower_costs() -> None:
    batch = _batch(np.array([[1.0, 1.0], [9.0, 9.0], [3.0, 3.0]]), np.array([[True, False], [False] * 2, [False] * 2]))
    np.testing.assert_array_equal(batch.best(3).cost.sum(axis=1), [6.0, 18.0, 2.0])
    assert batch.best(1).beats(batch[1:2], 1e-9) and not batch[:1].beats(batch[1:2], 1e-9)
    assert not batch[1:2].beats(batch[1:2], 1e-9)


@given(seed=st.integers(0, 10_000), points=st.integers(2, 30))
@settings(max_examples=30, deadline=None)
def test_points_are_even_along_the_path_and_on_it(seed: int, points: int) -> None:
    rng = np.random.default_rng(seed)
    path = Path(np.cumsum(rng.uniform(0.1, 1.0, (int(rng.integers(2, 6)), 2)), axis=0))
    q = evenly(path.q, points)
    np.testing.assert_allclose(q[[0, -1]], path.q[[0, -1]], atol=1e-12)
    direction, begin = np.diff(path.q, axis=0), path.q[:-1]
    t = np.einsum("psi,si->ps", q[:, None] - begin, direction) / np.square(direction).sum(axis=1)
    gap = np.linalg.norm(q[:, None] - begin - np.clip(t, 0, 1)[..., None] * direction, axis=2).min(axis=1)
    np.testing.assert_allclose(gap, 0.0, atol=1e-9)
    assert np.ptp(np.linalg.norm(np.diff(q, axis=0), axis=1)) < path.length / (points - 1)


# --- an arm -----------------------------------------------------------------------------------------------------------


def test_improves_the_motion_of_an_arm_and_keeps_it_free_at_the_finest_step() -> None:
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    kernels = compile_scene(task.scene).kernels
    problem = SceneProblem(kernels=kernels, start=task.start, goals=task.goal, margin=0.002)
    objective = gp.Objective(w=2.0).bind(task.scene)
    first = next(iter(gp.RRTConnect().solve(problem, objective, Budget(), np.random.default_rng(0))))
    paths = _improve(first, problem, objective, iterations=60)
    assert path_total(objective, paths[-1]) < 0.9 * path_total(objective, first)
    for path in paths:
        assert kernels.edges_free(path.q[:-1], path.q[1:], FINE_STEP, 0.002).all()


def test_the_first_path_is_checked_at_the_fine_step() -> None:
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    kernels = compile_scene(task.scene).kernels
    problem = SceneProblem(kernels=kernels, start=task.start, goals=task.goal, check_step=50.0)
    q = np.random.default_rng(0).uniform(problem.lower, problem.upper, (1000, 7))
    q = q[kernels.free(q)]
    hidden = problem.edges_free(q[:-1], q[1:]) & ~kernels.edges_free(q[:-1], q[1:], FINE_STEP)
    assert hidden.any()
    i = int(np.flatnonzero(hidden)[0])
    batch = Rollouts(q=q[None, i : i + 2], cost=np.ones((1, 1)), blocked=np.zeros((1, 1), bool))
    assert batch.with_first_finely_checked(problem).blocked.all()
    clear = Rollouts(q=np.stack([q[[i, i]], q[i : i + 2]]), cost=np.ones((2, 1)), blocked=np.zeros((2, 1), bool))
    assert clear.with_first_finely_checked(problem) is clear

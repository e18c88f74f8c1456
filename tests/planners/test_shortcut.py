"""Shortcuts: always cheaper, always free, and never back across a hazard."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.compare.problems.analytic import AnalyticProblem, analytic_problems, disc
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import Budget, path_total
from graceful_plan.planners.shortcut import MOVES, Line, Replacement, Shortcut, apply_best

_DETOUR = Path(np.array([[-2.0, 0.0], [-1.9, 1.5], [0.0, 2.5], [0.5, 1.5], [1.9, 1.5], [2.0, 0.0]]))


def _improve(path: Path, instance: AnalyticProblem, iterations: int = 200, seed: int = 0) -> list[Path]:
    budget = Budget(iterations=iterations)
    questions = InterruptibleProblem(instance.problem, instance.objective, budget)
    return list(Shortcut().improve(path, questions, budget, np.random.default_rng(seed)))


def test_reaches_the_taut_string() -> None:
    instance = disc()
    paths = _improve(_DETOUR, instance)
    assert path_total(instance.objective, paths[-1]) <= 1.02 * instance.optimum


@given(seed=st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_every_path_is_cheaper_free_inside_and_keeps_its_ends(seed: int) -> None:
    instance = disc()
    last = path_total(instance.objective, _DETOUR)
    for path in _improve(_DETOUR, instance, iterations=15, seed=seed):
        cost = path_total(instance.objective, path)
        assert cost < last
        assert instance.problem.edges_free(path.q[:-1], path.q[1:]).all()
        assert np.all((path.q >= instance.problem.lower) & (path.q <= instance.problem.upper))
        np.testing.assert_array_equal(path.q[[0, -1]], _DETOUR.q[[0, -1]])
        last = cost


def test_does_not_cut_back_across_a_hazard() -> None:
    """The straight line is the shortest path, but it crosses an expensive region."""
    problem = FunctionProblem(
        start=np.array([-2.0, 0.0]), goals=np.array([[2.0, 0.0]]), lower=np.full(2, -3.0), upper=np.full(2, 3.0)
    )
    objective = DensityObjective(density=lambda q: 20.0 * np.exp(-2.0 * (q**2).sum(axis=1)))
    budget = Budget(iterations=150)
    around = Path(np.array([[-2.0, 0.0], [-1.5, 1.5], [1.5, 1.5], [2.0, 0.0]]))
    questions = InterruptibleProblem(problem, objective, budget)
    *_, final = Shortcut().improve(around, questions, budget, np.random.default_rng(0))
    straight = path_total(objective, Path(np.array([[-2.0, 0.0], [2.0, 0.0]])))
    assert path_total(objective, final) < path_total(objective, around) < straight
    assert np.linalg.norm(final.resampled(0.02).q, axis=1).min() > 0.5


def test_bends_a_straight_line_away_from_a_hazard() -> None:
    instance = analytic_problems()["hyperbolic"]
    straight = Path(np.array([[0.0, 0.5], [1.0, 0.5]]))
    paths = _improve(straight, instance, iterations=400)
    assert path_total(instance.objective, paths[-1]) <= 1.03 * instance.optimum


def test_same_seed_same_paths() -> None:
    first, second = (_improve(_DETOUR, disc(), iterations=30, seed=3) for _ in range(2))
    assert len(first) == len(second) > 0
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


@pytest.mark.parametrize("path", [Path(np.zeros((1, 2))), Path(np.zeros((3, 2)))])
def test_a_path_without_length_stays(path: Path) -> None:
    assert _improve(path, analytic_problems()["free_space"]) == []


def test_nothing_without_a_budget() -> None:
    assert _improve(_DETOUR, disc(), iterations=0) == []


def test_gives_up_after_its_patience() -> None:
    instance = analytic_problems()["free_space"]
    budget = Budget(iterations=10_000)
    straight = Path(np.stack([instance.problem.start, instance.problem.goals[0]]))
    questions = InterruptibleProblem(instance.problem, instance.objective, budget)
    assert list(Shortcut(patience=7).improve(straight, questions, budget, np.random.default_rng(0))) == []
    assert budget.spent == 7


@pytest.mark.parametrize("move", sorted(set(MOVES), key=lambda move: move.__name__), ids=lambda move: move.__name__)
@given(seed=st.integers(0, 10_000))
def test_replacements_start_and_end_on_vertices(move, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(int(rng.integers(2, 9)), 3))
    line = Line(q, np.ones(len(q) - 1))
    for new in move(line, 10, float(rng.uniform(0.05, 1.0)), rng):
        assert 0 <= new.first < new.last < len(q)
        np.testing.assert_array_equal(new.q[0], q[new.first])
        np.testing.assert_array_equal(new.q[-1], q[new.last])


def test_replacements_that_overlap_are_not_both_taken() -> None:
    instance = analytic_problems()["free_space"]
    q = np.array([[-1.0, -1.0], [-0.5, 1.0], [0.0, -1.0], [0.5, 1.0], [0.5, 0.5]])
    questions = InterruptibleProblem(instance.problem, instance.objective, Budget())
    line = Line(q, questions.edge_costs(q[:-1], q[1:]))
    proposals = [Replacement(0, 2, q[[0, 2]]), Replacement(1, 3, q[[1, 3]]), Replacement(2, 4, q[[2, 4]])]
    result = apply_best(line, proposals, questions)
    assert result is not None
    np.testing.assert_array_equal(result.q, q[[0, 2, 4]])
    assert result.cost.sum() == pytest.approx(path_total(instance.objective, Path(result.q)))


def test_proposals_outside_of_the_limits_are_refused() -> None:
    problem = FunctionProblem(
        start=np.array([0.0, 0.0]), goals=np.array([[1.0, 0.0]]), lower=np.zeros(2), upper=np.ones(2)
    )
    objective = DensityObjective(density=lambda q: np.maximum(0.0, 5.0 + 20.0 * q[:, 1]))
    questions = InterruptibleProblem(problem, objective, Budget())
    q = np.stack([problem.start, problem.goals[0]])
    line = Line(q, questions.edge_costs(q[:-1], q[1:]))
    below = Replacement(0, 1, np.array([[0.0, 0.0], [0.5, -0.2], [1.0, 0.0]]))
    assert questions.edge_costs(below.q[:-1], below.q[1:]).sum() < line.cost.sum()
    assert apply_best(line, [below], questions) is None


@pytest.mark.parametrize(
    ("name", "value"), [("candidates", 0), ("patience", 0), ("least_gain", -1.0), ("least_reach", 0.0)]
)
def test_settings_are_checked(name: str, value: float) -> None:
    with pytest.raises(SettingError, match=name):
        Shortcut(**{name: value})

"""T-RRT and Bi-TRRT: laws of the transition test, and both stay in low-cost valleys."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from saddles import SaddleProblem, mechanical_work, saddle, saddle_density

from graceful_plan.compare.problems.analytic import disc
from graceful_plan.compare.problems.function_problem import DensityObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.trees.bitrrt import BiTRRT
from graceful_plan.planners.trees.transition import RefinementControl, TransitionSettings, TransitionTest
from graceful_plan.planners.trees.tree import Tree
from graceful_plan.planners.trees.trrt import TRRT

_VARIANTS = ("jaillet", "devaurs")


def _test(variant: str, cost_range: float = 1.0, **settings: float) -> TransitionTest:
    return TransitionTest(TransitionSettings(variant=variant, **settings), cost_range, np.random.default_rng(0))


def _grow(planner: TRRT, instance: SaddleProblem, iterations: int, seed: int = 0) -> Tree:
    questions = InterruptibleProblem(instance.problem, instance.objective, Budget(iterations=iterations))
    return planner.grow(questions, np.random.default_rng(seed))[0]


def _plain_rrt(problem, reach: float, goal_bias: float, iterations: int, rng: np.random.Generator) -> np.ndarray:
    """A textbook RRT that uses none of the code under test."""
    nodes = [problem.start]
    for _ in range(iterations):
        if rng.uniform() < goal_bias:
            target = problem.goals[rng.integers(len(problem.goals))]
        else:
            target = rng.uniform(problem.lower, problem.upper)
        distances = [np.linalg.norm(node - target) for node in nodes]
        near, distance = nodes[int(np.argmin(distances))], min(distances)
        if distance == 0.0:
            continue
        new = target if distance <= reach else near + reach / distance * (target - near)
        if not problem.edges_free(near[None], new[None])[0]:
            continue
        nodes.append(new)
        to_goal = np.linalg.norm(problem.goals[0] - new)
        if to_goal <= reach and problem.edges_free(new[None], problem.goals[:1])[0]:
            nodes += [problem.goals[0]] if to_goal > 0.0 else []
            break
    return np.array(nodes)


@pytest.mark.parametrize("variant", _VARIANTS)
@pytest.mark.parametrize("density", [0.0, 2.0])
def test_flat_cost_gives_the_tree_of_an_rrt(variant: str, density: float) -> None:
    problem = disc().problem
    planner = TRRT(variant=variant, range=0.4, refinement_ratio=np.inf)
    questions = InterruptibleProblem(
        problem, DensityObjective(density=lambda q: np.full(len(q), density)), Budget(iterations=150)
    )
    tree, _ = planner.grow(questions, np.random.default_rng(4))
    expected = _plain_rrt(problem, 0.4, planner.goal_bias, 150, np.random.default_rng(4))
    np.testing.assert_allclose(tree.q, expected, atol=1e-12)


@pytest.mark.parametrize("variant", _VARIANTS)
@given(drop=st.floats(0.0, 1e6), distance=st.floats(1e-6, 10.0))
def test_downhill_is_always_accepted_and_leaves_the_temperature(variant: str, drop: float, distance: float) -> None:
    test = _test(variant)
    before = test.temperature
    assert test.accepts(drop, 0.0, distance)
    assert test.temperature == before


@pytest.mark.parametrize("variant", _VARIANTS)
def test_temperature_falls_with_accepted_climbs_and_rises_with_rejections(variant: str) -> None:
    test = _test(variant, most_failures=3)
    rejected = 0
    while not test.accepts(0.0, 1.0, 1.0):
        rejected += 1
        assert rejected < 10_000
        hot = test.temperature
    assert rejected > 0
    assert hot > _test(variant).temperature
    assert test.temperature < hot


def test_jaillet_heats_only_after_too_many_failures() -> None:
    test = _test("jaillet", initial_temperature=1e-6, most_failures=5)
    history = []
    for _ in range(7):
        assert not test.accepts(0.0, 1.0, 1.0)
        history.append(test.temperature)
    assert history[:6] == [pytest.approx(1e-6)] * 6
    assert history[6] == pytest.approx(2e-6)


def test_devaurs_accepts_exactly_below_the_half_probability() -> None:
    temperature = 0.1
    below, above = 0.99 * temperature * np.log(2.0), 1.01 * temperature * np.log(2.0)
    assert _test("devaurs", initial_temperature=temperature).accepts(0.0, below, 1.0)
    assert not _test("devaurs", initial_temperature=temperature).accepts(0.0, above, 1.0)


@pytest.mark.parametrize("variant", _VARIANTS)
def test_temperature_stays_finite(variant: str) -> None:
    test = _test(variant, most_failures=0)
    for _ in range(3000):
        test.accepts(0.0, 1e300, 1e-9)
    assert 0.0 < test.temperature <= 1.001e12
    for _ in range(3000):
        test.accepts(0.0, 0.2, 1.0)
    assert 0.9e-12 <= test.temperature <= 1.001e12


@pytest.mark.parametrize("variant", _VARIANTS)
@pytest.mark.parametrize("planner", [TRRT, BiTRRT])
@pytest.mark.parametrize("changed", [saddle(scale=8.0), saddle(offset=0.5), saddle(scale=0.25, offset=3.0)])
def test_scaling_the_cost_or_adding_a_constant_changes_nothing(planner, variant: str, changed: SaddleProblem) -> None:
    paths = [_first(planner, instance, variant=variant, most_failures=1) for instance in (saddle(), changed)]
    np.testing.assert_allclose(paths[0].q, paths[1].q, atol=1e-9)


def _first(planner, instance: SaddleProblem, seed: int = 1, **settings: object) -> Path:
    """Return the planner's first path; a low initial temperature keeps the number of iterations small."""
    built = planner(shortcut=False, initial_temperature=0.01, **settings)
    budget = Budget(iterations=6000)
    return next(built.solve(instance.problem, instance.objective, budget, np.random.default_rng(seed)))


def _work(planner, seed: int, **settings: object) -> float:
    """Return the mechanical work of the first path, relative to the least possible."""
    instance = saddle()
    return mechanical_work(saddle_density, _first(planner, instance, seed, **settings)) / instance.least_work


@pytest.mark.parametrize("planner", [TRRT, BiTRRT])
@pytest.mark.parametrize("variant", _VARIANTS)
def test_climbs_less_than_half_of_what_the_straight_line_does(planner, variant: str) -> None:
    straight = mechanical_work(saddle_density, Path(np.array([[-1.5, 0.0], [1.5, 0.0]])))
    works = [_work(planner, seed, variant=variant, most_failures=2) for seed in range(3)]
    assert np.median(works) < 0.5 * straight / saddle().least_work
    assert min(works) >= 1.0 - 1e-3


@pytest.mark.long
def test_more_patience_finds_lower_passes() -> None:
    hasty = [_work(TRRT, seed, variant="jaillet", most_failures=0) for seed in range(8)]
    patient = [_work(TRRT, seed, variant="jaillet", most_failures=20) for seed in range(8)]
    assert np.median(patient) < np.median(hasty)
    assert np.median(patient) <= 1.15


def test_refinement_is_rationed() -> None:
    control = RefinementControl(ratio=0.5, reach=1.0)
    control.added(1.0)
    assert control.allows(0.3)
    control.added(0.3)
    assert not control.allows(0.3)
    assert control.allows(1.0)
    for _ in range(2):
        control.added(1.0)
    assert control.allows(0.3)


def test_refinement_control_spreads_the_tree() -> None:
    def short_edges(ratio: float) -> float:
        tree = _grow(TRRT(range=0.5, refinement_ratio=ratio), saddle(), 400)
        steps = [np.linalg.norm(tree.q[i] - tree.q[p]) for i, p in enumerate(tree.parents) if p >= 0]
        return float(np.mean(np.array(steps) < 0.499))

    assert short_edges(0.1) < 0.2 < short_edges(np.inf)


def test_tree_grows_and_finds_its_nearest() -> None:
    rng = np.random.default_rng(0)
    tree = Tree(np.zeros((1, 3)), np.zeros(1))
    for i in range(600):
        tree.add(rng.normal(size=3), 0.0, int(rng.integers(i + 1)))
    target = rng.normal(size=3)
    index, distance = tree.nearest(target)
    distances = np.linalg.norm(tree.q - target, axis=1)
    assert index == distances.argmin()
    assert distance == pytest.approx(distances.min())
    np.testing.assert_array_equal(tree.branch(600)[0], np.zeros(3))


@pytest.mark.parametrize("planner", [TRRT, BiTRRT])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("variant", "kuffner"),
        ("range", 0.0),
        ("refinement_ratio", -0.1),
        ("refinement_ratio", np.nan),
        ("initial_temperature", 0.0),
        ("most_failures", -1),
    ],
)
def test_settings_are_checked(planner, name: str, value: object) -> None:
    with pytest.raises((SettingError, TypeError), match=name):
        planner(**{name: value})

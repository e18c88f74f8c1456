"""Connection of configurations to the tree of RRT*, against brute force over every edge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.compare.problems.analytic import disc
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.path import Path
from graceful_plan.planners.informed import probe_objective
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import BoundObjective, Budget, Problem, edge_totals, path_total
from graceful_plan.planners.trees.star_tree import StarTree
from graceful_plan.planners.trees.wiring import EdgeGuess, TreeConnector

_NO_WAY = np.zeros(0, dtype=int)
_HILL = DensityObjective(density=lambda q: 3.0 * np.exp(-((q[:, 0] + 1.2) ** 2) - q[:, 1] ** 2), step=0.1)


class _Uphill:
    """Costs of going up the first axis, and twice as much along the second: length gives no bound."""

    w = 1.0

    def edges(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        climb = np.maximum(0.0, q1[:, 0] - q0[:, 0])
        return np.stack([np.linalg.norm((q1 - q0) * [1.0, 2.0], axis=1), climb], axis=1)

    def states(self, q: np.ndarray) -> np.ndarray:
        return np.abs(q[:, 0])


_OBJECTIVES = pytest.mark.parametrize("objective", [_HILL, _Uphill()], ids=["hill", "uphill"])


class _Asked(Problem):
    """Records the edges that are checked."""

    def __init__(self, inner: FunctionProblem) -> None:
        self.inner = inner
        self.start, self.goals, self.lower, self.upper = inner.start, inner.goals, inner.lower, inner.upper
        self.edges: list[tuple[bytes, bytes]] = []

    def states_free(self, q: np.ndarray) -> np.ndarray:
        return self.inner.states_free(q)

    def edges_free(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        self.edges += [(a.tobytes(), b.tobytes()) for a, b in zip(q0, q1, strict=True)]
        return self.inner.edges_free(q0, q1)


def _wiring(
    objective: BoundObjective, bounded: bool = False, problem: Problem | None = None, trust: float = 0.0
) -> TreeConnector:
    problem = problem or disc().problem
    questions = InterruptibleProblem(problem, objective, Budget())
    bound = probe_objective(objective, problem).length_bound
    ends = np.concatenate([problem.start[None], problem.goals])
    tree = StarTree(problem.start, problem.goals, questions.state_costs(ends))
    guess = EdgeGuess.learn(questions, bound=bound, reach=0.5, trust=trust)
    return TreeConnector(tree, questions, guess, bounded=bounded)


def _samples(wiring: TreeConnector, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return configurations with a free edge to a node, and these nodes."""
    problem = wiring.questions.problem
    q = rng.uniform(problem.lower, problem.upper, (8 * n, len(problem.start)))
    near = wiring.tree.nearest(q)
    free = problem.edges_free(wiring.tree.q[near], q)
    return q[free][:n], near[free][:n]


def _grown(wiring: TreeConnector, rng: np.random.Generator, batches: int = 8, k: int = 8) -> TreeConnector:
    for _ in range(batches):
        wiring.join(*_samples(wiring, 6, rng), k, _NO_WAY)
    return wiring


def _edge_costs(wiring: TreeConnector, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """Return the costs of edges, infinite if blocked."""
    q0, q1 = np.broadcast_arrays(q0, q1)
    questions = wiring.questions
    return np.where(questions.problem.edges_free(q0, q1), edge_totals(questions.objective, q0, q1), np.inf)


@_OBJECTIVES
@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("trust", [0.0, 0.5, 1.0])
def test_costs_equal_those_of_paths_along_the_tree(objective: BoundObjective, bounded: bool, trust: float) -> None:
    wiring = _grown(_wiring(objective, bounded, trust=trust), np.random.default_rng(0))
    tree, problem = wiring.tree, wiring.questions.problem
    assert len(tree) > 10
    for node in np.flatnonzero(np.isfinite(tree.cost)):
        path = Path(tree.q[tree.branch(int(node))])
        assert problem.edges_free(path.q[:-1], path.q[1:]).all()
        assert tree.cost[node] == pytest.approx(path_total(objective, path) if len(path.q) > 1 else 0.0)
    np.testing.assert_allclose(tree.impact, objective.w * objective.states(tree.q))


@_OBJECTIVES
@given(seed=st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_the_cheapest_parent_is_chosen_and_all_rewirings_are_done(objective: BoundObjective, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wiring = _grown(_wiring(objective), rng, batches=3)
    tree, (q, near) = wiring.tree, _samples(wiring, 1, rng)
    known, before = tree.q.copy(), tree.cost.copy()
    (new,) = wiring.join(q, near, len(tree), _NO_WAY)
    assert tree.cost[new] == pytest.approx((before + _edge_costs(wiring, known, q)).min())
    over = tree.cost[new] + _edge_costs(wiring, q, known)
    assert np.all(tree.cost[:new] <= np.minimum(before, over) * (1.0 + 1e-8))


@_OBJECTIVES
@given(seed=st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_an_informed_search_never_skips_an_improvement(objective: BoundObjective, seed: int) -> None:
    """A configuration is added if the path through it is cheaper than the best one."""
    rng = np.random.default_rng(seed)
    wiring = _grown(_wiring(objective, bounded=True), rng, batches=6)
    tree = wiring.tree
    for _ in range(10):
        q, near = _samples(wiring, 1, rng)
        come = (tree.cost + _edge_costs(wiring, tree.q, q)).min()
        over = come + _edge_costs(wiring, q, tree.q[tree.goals])[0]
        before = tree.cost[tree.goals].min()
        joined = wiring.join(q, near, len(tree), _NO_WAY)
        assert len(joined) == 1 or over >= before * (1.0 - 1e-9)
        assert tree.cost[tree.goals].min() <= min(before, over) * (1.0 + 1e-8)


def test_an_informed_search_skips_hopeless_samples() -> None:
    wiring = _wiring(_HILL, bounded=True)
    wiring.tree.lead(1, 0, 4.6)
    aside = np.array([[-2.0, 2.9]])
    assert len(wiring.join(aside, np.zeros(1, dtype=int), 4, _NO_WAY)) == 0
    assert len(_wiring(_HILL).join(aside, np.zeros(1, dtype=int), 4, _NO_WAY)) == 1


def test_no_edge_is_checked_twice() -> None:
    problem = _Asked(disc().problem)
    wiring = _wiring(_HILL, problem=problem)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, near = _samples(wiring, 6, rng)
        known = {(wiring.tree.q[node].tobytes(), row.tobytes()) for node, row in zip(near, q, strict=True)}
        problem.edges.clear()
        wiring.join(q, near, 8, _NO_WAY)
        asked = [frozenset(edge) for edge in problem.edges]
        assert len(set(asked)) == len(asked)
        assert not set(asked) & {frozenset(edge) for edge in known}


def test_joining_nothing_changes_nothing() -> None:
    wiring = _wiring(_HILL)
    assert len(wiring.join(np.zeros((0, 2)), _NO_WAY, 5, _NO_WAY)) == 0
    assert len(wiring.tree) == 2


def test_distant_nodes_are_rewired_over_a_new_one() -> None:
    """The distant node is not among the neighbours, but on the best path."""
    problem = FunctionProblem(
        start=np.zeros(2), goals=np.array([[9.0, 0.0]]), lower=np.full(2, -1.0), upper=np.full(2, 10.0)
    )
    objective = DensityObjective(density=lambda q: np.zeros(len(q)), w=0.0)
    wiring = _wiring(objective, problem=problem)
    tree = wiring.tree
    for q, parent in (([0.0, 5.0], 0), ([8.0, 5.0], 2), ([8.0, 1.0], 3)):
        step = np.linalg.norm(np.array(q) - tree.q[parent])
        tree.add(np.array([q]), np.array([parent]), np.array([step]), np.zeros(1))
    middle, near = np.array([[1.0, 0.0]]), np.zeros(1, dtype=int)
    wiring.join(middle, near, 1, np.array([4]))
    np.testing.assert_array_equal(tree.branch(4), [0, 5, 4])
    np.testing.assert_array_equal(tree.branch(1), [0, 5, 1])
    np.testing.assert_array_equal(tree.branch(3), [0, 2, 3])


def test_guesses_are_exact_where_the_impact_is_the_same_everywhere() -> None:
    problem = disc().problem
    objective = DensityObjective(density=lambda q: np.full(len(q), 2.0), w=1.5)
    guess = EdgeGuess.learn(InterruptibleProblem(problem, objective, Budget()), bound=1.0, reach=0.5, trust=0.5)
    np.testing.assert_allclose(guess.expected(np.array([0.7, 0.1]), np.full(2, 1.5 * 2.0)), [0.7 * 4.0, 0.1 * 4.0])
    length = np.array([0.7])
    np.testing.assert_allclose(guess.least(length, guess.expected(length, np.full(1, 3.0))), 0.7 * (0.5 + 0.5 * 4.0))


def test_trust_leaves_out_edges() -> None:
    """Trust connects the same configurations to the same nodes with fewer edge checks."""
    asked = []
    for trust in (0.0, 0.5):
        problem = _Asked(disc().problem)
        wiring = _wiring(_HILL, problem=problem, trust=trust)
        _grown(wiring, np.random.default_rng(0), batches=1)
        problem.edges.clear()
        q = np.array([[-2.0, 0.3], [-1.5, 0.8], [-1.0, 1.5]])
        near = wiring.tree.nearest(q)
        wiring.join(q, near, 8, _NO_WAY)
        asked.append(len(problem.edges))
    assert asked[1] < asked[0]

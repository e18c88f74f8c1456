"""Graph searches: equal to the enumeration of all paths, exact fronts, valid bounds."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.planners.roadmaps.graph import Graph, non_dominated, spread_out

Edge = tuple[int, int, float, float]


@st.composite
def graphs(draw: st.DrawFn, whole: bool = True) -> tuple[int, list[Edge]]:
    """Small graphs with loops and parallel edges; integer costs add up without rounding and are often equal."""
    n = draw(st.integers(2, 7))
    node = st.integers(0, n - 1)
    cost = st.integers(0, 6).map(float) if whole else st.floats(0.0, 10.0)
    return n, draw(st.lists(st.tuples(node, node, cost, cost), max_size=18))


def of(n: int, edges: list[Edge]) -> tuple[Graph, np.ndarray]:
    cost = np.array([[v, s] for _, _, v, s in edges]).reshape(-1, 2)
    return Graph(n, [a for a, *_ in edges], [b for _, b, *_ in edges]), cost


def enumerate_paths(edges: list[Edge], start: int, goals: set[int]) -> Iterator[tuple[float, float]]:
    """Return the costs of every simple path, by depth-first search without pruning."""

    def extend(node: int, seen: frozenset[int], v: float, s: float) -> Iterator[tuple[float, float]]:
        if node in goals:
            yield v, s
        for a, b, dv, ds in edges:
            if a == node and b not in seen:
                yield from extend(b, seen | {b}, v + dv, s + ds)

    yield from extend(start, frozenset({start}), 0.0, 0.0)


def brute_force_front(edges: list[Edge], start: int, goals: set[int]) -> list[tuple[float, float]]:
    every = set(enumerate_paths(edges, start, goals))
    return sorted(p for p in every if not any(o != p and o[0] <= p[0] and o[1] <= p[1] for o in every))


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(graphs(), st.data())
def test_the_front_equals_that_of_all_paths(case, data):
    n, edges = case
    start = data.draw(st.integers(0, n - 1))
    goals = data.draw(st.sets(st.integers(0, n - 1), min_size=1, max_size=3))
    graph, cost = of(n, edges)
    found = graph.front(cost, start, sorted(goals))
    assert found.complete
    assert [tuple(row) for row in found.cost.tolist()] == brute_force_front(edges, start, goals)


@settings(max_examples=50, deadline=None)
@given(graphs(whole=False))
def test_the_front_of_costs_that_round(case):
    n, edges = case
    graph, cost = of(n, edges)
    found, every = graph.front(cost, 0, [n - 1]).cost, brute_force_front(edges, 0, {n - 1})
    for point in every:  # found, or replaced by one that is equal up to rounding
        assert (found <= np.array(point) * (1.0 + 1e-9) + 1e-300).all(axis=1).any()
    for point in found.tolist():
        assert any(np.allclose(point, other, rtol=1e-9) for other in every)


@settings(max_examples=50, deadline=None)
@given(graphs())
def test_paths_lead_from_start_to_goal_at_the_stated_cost(case):
    n, edges = case
    graph, cost = of(n, edges)
    found = graph.front(cost, 0, [n - 1])
    for steps, total in zip(found.edges, found.cost, strict=True):
        nodes = [0, *graph.head[steps].tolist()]
        assert [(a, b) for a, b in pairwise(nodes)] == list(zip(graph.tail[steps], graph.head[steps], strict=True))
        assert nodes[-1] == n - 1
        assert np.array_equal(cost[steps].sum(axis=0), total)
        assert len(set(nodes)) == len(nodes)


@settings(max_examples=50, deadline=None)
@given(graphs(), st.floats(0.0, 5.0))
def test_cheapest_paths_are_on_the_front_and_none_is_cheaper(case, w):
    n, edges = case
    graph, cost = of(n, edges)
    steps, total = graph.cheapest(cost @ (1.0, w), 0, [n - 1])
    front = graph.front(cost, 0, [n - 1]).cost
    if len(front) == 0:
        assert total == np.inf and len(steps) == 0
        return
    assert total == pytest.approx((front @ (1.0, w)).min(), rel=1e-12, abs=1e-12)
    ends = graph.tail[steps[:1]].tolist(), graph.head[steps[-1:]].tolist()
    assert ends == ([0], [n - 1]) or len(steps) == 0


@settings(max_examples=50, deadline=None)
@given(graphs(), st.floats(0.0, 1.0))
def test_epsilon_fronts_are_within_epsilon(case, epsilon):
    n, edges = case
    graph, cost = of(n, edges)
    every, some = graph.front(cost, 0, [n - 1]).cost, graph.front(cost, 0, [n - 1], epsilon).cost
    assert {tuple(p) for p in some} <= {tuple(p) for p in every}
    for v, s in every:
        assert any(v1 <= v and s1 <= (1.0 + epsilon) * s * (1.0 + 1e-9) for v1, s1 in some)


def test_parts_of_a_front_that_no_weighted_sum_finds():
    # three parallel edges: (0, 10), (6, 6) above the line between the others, (10, 0)
    graph = Graph(2, [0, 0, 0], [1, 1, 1])
    cost = np.array([[0.0, 10.0], [6.0, 6.0], [10.0, 0.0]])
    assert graph.front(cost, 0, [1]).cost.tolist() == cost.tolist()
    by_sums = {int(graph.cheapest(cost @ (1.0, w), 0, [1])[0][0]) for w in np.geomspace(1e-3, 1e3, 200)}
    assert by_sums == {0, 2}


def test_infinite_costs_are_no_edges():
    graph = Graph(3, [0, 1, 0], [1, 2, 2])
    assert graph.cheapest([1.0, 1.0, np.inf], 0, [2])[1] == 2.0
    assert graph.cheapest([1.0, np.inf, np.inf], 0, [2])[1] == np.inf
    assert len(graph.front([[1.0, 1.0], [1.0, np.inf], [np.inf, 0.0]], 0, [2]).cost) == 0


def test_start_at_a_goal_and_no_goal():
    graph = Graph(2, [0], [1])
    assert graph.cheapest([1.0], 0, [0, 1])[1] == 0.0
    assert graph.front([[1.0, 1.0]], 0, [0, 1]).cost.tolist() == [[0.0, 0.0]]
    assert graph.cheapest([1.0], 0, [])[1] == np.inf
    assert len(graph.front([[1.0, 1.0]], 0, []).cost) == 0


def doubling(n: int) -> tuple[Graph, np.ndarray]:
    """A chain of n links, each either long or dangerous by the same amount: all of its 2^n paths are on the front."""
    tail, price = np.repeat(np.arange(n), 2), 2.0 ** np.repeat(np.arange(n), 2)
    dangerous = np.arange(2 * n) % 2 == 1
    return Graph(n + 1, tail, tail + 1), np.stack([price * ~dangerous, price * dangerous], axis=1)


def test_fronts_may_be_exponential():
    graph, cost = doubling(10)
    assert graph.front(cost, 0, [10]).cost[:, 0].tolist() == list(range(1024))


def test_a_search_without_time_says_so():
    graph, cost = doubling(16)
    cut = graph.front(cost, 0, [16], seconds=0.0)
    assert not cut.complete
    assert len(cut.cost) < 1 << 16
    assert graph.front(cost, 0, [16], epsilon=0.5).complete


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: Graph(2, [0], [2]), SettingError, "head"),
        (lambda: Graph(2, [-1], [1]), SettingError, "tail"),
        (lambda: Graph(2, [0, 1], [1]), ShapeError, "head"),
        (lambda: Graph(2, [0], [1]).cheapest([np.nan], 0, [1]), SettingError, "at least 0"),
        (lambda: Graph(2, [0], [1]).cheapest([-1.0], 0, [1]), SettingError, "at least 0"),
        (lambda: Graph(2, [0], [1]).cheapest([1.0, 1.0], 0, [1]), ShapeError, "cost"),
        (lambda: Graph(2, [0], [1]).cheapest([1.0], 2, [1]), SettingError, "start"),
        (lambda: Graph(2, [0], [1]).cheapest([1.0], 0, [7]), SettingError, "goals"),
        (lambda: Graph(2, [0], [1]).front([[1.0, 1.0]], 0, [1], epsilon=-0.1), SettingError, "epsilon"),
        (lambda: Graph(2, [0], [1]).front([[1.0, 1.0]], 0, [1], epsilon=np.nan), SettingError, "epsilon"),
        (lambda: Graph(2, [0], [1]).front([[1.0, 1.0]], 0, [1], seconds=np.nan), SettingError, "seconds"),
    ],
)
def test_misuse_is_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=20))
def test_non_dominated_rows(points):
    cost = np.array(points, dtype=float).reshape(-1, 2)
    kept = [tuple(row) for row in cost[non_dominated(cost)]]
    expected = {p for p in points if not any(o != p and o[0] <= p[0] and o[1] <= p[1] for o in points)}
    assert kept == sorted(expected)


def test_spread_out_keeps_the_ends():
    cost = np.array([[x, 100.0 - x] for x in (0.0, 1.0, 2.0, 3.0, 50.0, 100.0)])
    every = np.arange(6)
    assert spread_out(cost, every, None).tolist() == every.tolist()
    assert spread_out(cost, every, 3).tolist() == [0, 4, 5]
    assert spread_out(cost, every, 2).tolist() == [0, 5]
    assert spread_out(cost, every, 1).tolist() == [0]

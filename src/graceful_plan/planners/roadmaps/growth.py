"""Growth of a roadmap: sampling of nodes, choice of edges, and edge costs.

Nodes are added in batches. The first nodes are sampled everywhere and around the straight lines between given pairs of
configurations. Later nodes lie near the roadmap's best paths between these pairs, for several weights; each is
connected to both sides of the stretch that it may replace. So the roadmap becomes dense along good paths for all
weights.

References:
    Kavraki et al., "Probabilistic roadmaps for path planning in high-dimensional configuration spaces", T-RO 1996.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.planners.planner import Problem
from graceful_plan.planners.roadmaps.edge_prices import EdgeCosts, Edges, Price, symmetric
from graceful_plan.planners.roadmaps.graph import Graph
from graceful_plan.planners.shortcut import Line

FIRST_SHARE = 0.3
"""Share of the nodes that are sampled before there are paths to sample near."""
WEIGHTS = (0.0, 0.2, 1.0, 5.0)
"""Safety weights of the paths near which nodes are sampled."""
_BATCHES = 24
_LEAST_BATCH = 8
_PAIRS_AT_ONCE = 6  # pairs near whose paths a batch is sampled
_TRIED = 4  # samples per node: the one with the least impact is kept
_DRAWS = 20  # attempts at sampling free nodes
_AROUND = 0.7  # share of the first nodes that lie around straight lines
_ASIDE = 0.35  # distance of nodes from a stretch, relative to its length
_CHORDS = 2  # one in `_CHORDS` stretches also gets a straight edge between its ends
_PROBES = 32  # edges for testing whether both directions cost the same
_CHUNK = 64  # edges that a thread evaluates at once
_BLOCK = 512  # configurations in a batch of nearest-neighbour search


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Inputs of roadmap growth.

    Args:
        problem: Problem for collision checks, with the check step of final paths.
        impact: Impact of a failure at rest, by which nodes are preferred.
        price: Costs of edges, in the direction in which they are given.
        severity: Severity of each column of the costs.
        threads: Number of threads; above 1 only if all of these functions are thread-safe.
    """

    problem: Problem
    impact: Callable[[Float[Array, "n nq"]], Float[Array, " n"]]
    price: Price
    severity: Float[Array, " column"]
    threads: int = 1


@final
class Growth:
    """A growing roadmap.

    Args:
        ground: Inputs of growth.
        pairs: Free starts and goals to grow between; may be empty.
        neighbours: Number of nearest nodes that each of the first nodes is connected to; half as many for later nodes.
        rng: Random numbers.
        deadline: Clock reading at which growth stops [s]; the current batch is then discarded.
    """

    def __init__(
        self,
        ground: Ground,
        pairs: Float[Array, "pair 2 nq"],
        neighbours: int,
        rng: np.random.Generator,
        deadline: float = np.inf,
    ) -> None:
        self.ground, self.neighbours, self.rng, self.deadline = ground, neighbours, rng, deadline
        self.q, place = np.unique(pairs.reshape(-1, pairs.shape[-1]), axis=0, return_inverse=True)
        self.pairs = place.reshape(-1, 2)
        self._parts: list[Edges] = []
        self._impact: list[Float[Array, " edge"]] = []  # of each part
        self._both_ways: bool | None = None  # whether costs differ by direction; None if unknown
        self._tried: set[tuple[int, ...]] = set()  # links
        self._turn = 0

    @property
    def edges(self) -> Edges:
        """All edges."""
        return Edges.concatenated(self._parts)

    def grow(self, n: int) -> None:
        """Add nodes until there are `n` or the time is over."""
        first = int(np.ceil(FIRST_SHARE * n)) if len(self.pairs) else n
        batch = max(_LEAST_BATCH, n // _BATCHES)
        with ThreadPoolExecutor(self.ground.threads) as pool:
            while len(self.q) < n and time.perf_counter() < self.deadline:
                count = min(batch, n - len(self.q))
                paths = self._paths() if len(self.q) >= first else []
                q, links = self._beside(count, paths) if paths else self._anywhere(count)
                neighbours = max(2, self.neighbours // 2) if paths else self.neighbours
                if len(q) == 0 or not self._add(q, links, neighbours, pool):
                    return

    def _anywhere(self, n: int) -> tuple[Float[Array, "n nq"], Int[Array, "link 2"]]:
        """Sample nodes everywhere and around straight lines; return also links in addition to nearest neighbours."""
        problem, rng = self.ground.problem, self.rng
        found: list[Array] = [np.zeros((0, len(problem.lower)))]
        for _ in range(_DRAWS):
            m = 2 * _TRIED * (n - sum(map(len, found))) + 16
            q = rng.uniform(problem.lower, problem.upper, (m, len(problem.lower)))
            if len(self.pairs):
                near = np.flatnonzero(rng.uniform(size=m) < _AROUND)
                q[near] = self._around(len(near))
            q = problem.projected(q)
            found.append(self._selected(q)[0])
            if sum(map(len, found)) >= n:
                break
        straight = self.pairs[:0] if self._parts else self.pairs  # only in the first batch
        return np.concatenate(found)[:n], straight

    def _around(self, n: int) -> Float[Array, "n nq"]:
        problem, rng = self.ground.problem, self.rng
        pair, t = self.pairs[rng.integers(len(self.pairs), size=n)], rng.uniform(size=(n, 1))
        extent = float(np.linalg.norm(problem.upper - problem.lower))
        spread = 0.25 * extent * rng.uniform(size=(n, 1)) / np.sqrt(len(problem.lower))
        q = (1.0 - t) * self.q[pair[:, 0]] + t * self.q[pair[:, 1]] + spread * rng.normal(size=(n, len(problem.lower)))
        return np.clip(q, problem.lower, problem.upper)

    def _selected(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
        """Keep the one of every `_TRIED` free configurations with the least impact; return also the indices."""
        free = np.flatnonzero(self.ground.problem.states_free(q))
        groups = free[: len(free) // _TRIED * _TRIED].reshape(-1, _TRIED)
        impact = self.ground.impact(q[groups.ravel()]).reshape(groups.shape)
        kept = groups[np.arange(len(groups)), np.argmin(impact, axis=1)]
        return q[kept], kept

    def _paths(self) -> list[Int[Array, " node"]]:
        """Return the nodes along the best paths between some of the pairs."""
        if not self._parts:
            return []
        tail = np.concatenate([part.tail for part in self._parts])
        head = np.concatenate([part.head for part in self._parts])
        motion = np.concatenate([part.prices.motion for part in self._parts])
        graph, impact = Graph(len(self.q), tail, head), np.concatenate(self._impact)
        turn = np.arange(self._turn, self._turn + min(_PAIRS_AT_ONCE, len(self.pairs))) % len(self.pairs)
        self._turn += len(turn)
        paths: dict[tuple[int, ...], Array] = {}
        for start, goal in self.pairs[turn].tolist():
            for w in WEIGHTS:
                steps, _ = graph.cheapest(motion + w * impact, start, [goal])
                if len(steps):
                    nodes = np.append(tail[steps[0]], head[steps])
                    paths[tuple(nodes.tolist())] = nodes
        return list(paths.values())

    def _beside(self, n: int, paths: list[Array]) -> tuple[Float[Array, "n nq"], Int[Array, "link 2"]]:
        """Sample nodes near stretches of paths, with links to both ends of each stretch."""
        problem, rng = self.ground.problem, self.rng
        counts = np.bincount(rng.integers(len(paths), size=2 * _TRIED * n + 16), minlength=len(paths))
        drawn = [_beside(self.q[path], path, m, rng) for path, m in zip(paths, counts.tolist(), strict=True)]
        q = problem.projected(np.clip(np.concatenate([q for q, _ in drawn]), problem.lower, problem.upper))
        sides = np.concatenate([sides for _, sides in drawn])
        mixed = rng.permutation(len(q))
        q, kept = self._selected(q[mixed])
        sides, q = sides[mixed[kept]][:n], q[:n]
        new = np.repeat(np.arange(len(self.q), len(self.q) + len(q)), 2)
        return q, np.concatenate([np.stack([sides.ravel(), new], axis=1), sides[::_CHORDS]])

    def _add(
        self, q: Float[Array, "n nq"], links: Int[Array, "link 2"], neighbours: int, pool: ThreadPoolExecutor
    ) -> bool:
        """Add nodes with their edges; return False and add nothing if the time ends before the costs are known."""
        nodes, first = np.concatenate([self.q, q]), len(self.q)
        near = nearest(q, nodes, neighbours + 1)  # the nearest is the node itself
        own = np.repeat(np.arange(first, len(nodes)), near.shape[1])
        links = np.unique(np.sort(np.concatenate([links, np.stack([near.ravel(), own], axis=1)]), axis=1), axis=0)
        links = self._untried(links[links[:, 0] < links[:, 1]])
        if self._both_ways is None:
            probes = links[:_PROBES]
            known = symmetric(self.ground.price, nodes[probes[:, 0]], nodes[probes[:, 1]])
            self._both_ways = None if known is None else not known
        chunks = [links[i : i + _CHUNK] for i in range(0, len(links), _CHUNK)]
        parts = [part for part in pool.map(lambda chunk: self._priced(nodes, chunk), chunks) if part is not None]
        if len(parts) < len(chunks):
            return False
        self.q = nodes
        self._tried.update(map(tuple, links.tolist()))
        self._parts += parts
        self._impact += [part.prices.impact(self.ground.severity) for part in parts]
        return True

    def _untried(self, links: Int[Array, "link 2"]) -> Int[Array, "fresh 2"]:
        return np.array([link for link in links.tolist() if tuple(link) not in self._tried], dtype=int).reshape(-1, 2)

    def _priced(self, nodes: Float[Array, "node nq"], links: Int[Array, "link 2"]) -> Edges | None:
        """Return the free edges of some links in both directions, with their costs; None if the time is over."""
        if time.perf_counter() > self.deadline:
            return None
        i, j = links[self.ground.problem.edges_free(nodes[links[:, 0]], nodes[links[:, 1]])].T.astype(np.int32)
        there = self.ground.price(nodes[i], nodes[j])
        back = there if self._both_ways is False else self.ground.price(nodes[j], nodes[i])
        return Edges(np.concatenate([i, j]), np.concatenate([j, i]), EdgeCosts.concatenated([there, back]))


def _beside(
    q: Float[Array, "vertex nq"], nodes: Int[Array, " vertex"], n: int, rng: np.random.Generator
) -> tuple[Float[Array, "n nq"], Int[Array, "n 2"]]:
    """Sample points near random stretches of a path, between path and chord; return also the nodes at both ends."""
    line = Line(q, np.zeros(len(q) - 1))
    ends = np.sort(rng.uniform(0.0, line.arc[-1], (n, 2)), axis=1)
    (first, a), (last, b) = line.at(ends[:, 0]), line.at(ends[:, 1])
    _, on_path = line.at(ends.mean(axis=1))
    share, span = rng.uniform(size=(n, 1)), ends[:, 1:] - ends[:, :1]
    noise = rng.normal(size=on_path.shape) / np.sqrt(on_path.shape[1])
    aside = _ASIDE * span * 10.0 ** rng.uniform(-1.5, 0.0, (n, 1)) * noise
    points = share * on_path + (1.0 - share) * 0.5 * (a + b) + aside
    return points, np.stack([nodes[first], nodes[last + 1]], axis=1)


def nearest(q: Float[Array, "m nq"], nodes: Float[Array, "node nq"], k: int) -> Int[Array, "m k"]:
    """Return the k nearest nodes of each configuration, all of them if there are fewer, by ascending distance."""
    k = min(k, len(nodes))
    if k == 0:
        return np.zeros((len(q), 0), dtype=int)
    found = [np.zeros((0, k), dtype=int)]
    squares = np.einsum("ij,ij->i", nodes, nodes)
    for begin in range(0, len(q), _BLOCK):
        distance = squares - 2.0 * q[begin : begin + _BLOCK] @ nodes.T
        near = np.argpartition(distance, k - 1, axis=1)[:, :k]
        order = np.argsort(np.take_along_axis(distance, near, axis=1), axis=1, kind="stable")
        found.append(np.take_along_axis(near, order, axis=1))
    return np.concatenate(found)

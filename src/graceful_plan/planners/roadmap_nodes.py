"""Where a roadmap has its nodes, and which of them are neighbours."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graceful_plan.array_types import Bool, Float, Int

Array = np.ndarray

_BLOCK = 512
_ROUNDS = 50


def draw_nodes(
    n: int,
    anchors: Float[Array, "anchor nq"],
    limits: tuple[Float[Array, " nq"], Float[Array, " nq"]],
    free: Callable[[Float[Array, "m nq"]], Bool[Array, " m"]],
    impact: Callable[[Float[Array, "m nq"]], Float[Array, " m"]],
    rng: np.random.Generator,
    around: float = 0.7,
) -> Float[Array, "node nq"]:
    """Draw at most `n` free configurations: some everywhere, more around the straight ways between anchors.

    Of every two candidates the one with less impact is taken more often.
    """
    lower, upper = limits
    found: list[Array] = []
    count = 0
    for _ in range(_ROUNDS):
        if count >= n:
            break
        m = 4 * (n - count) + 16
        q = rng.uniform(lower, upper, (m, len(lower)))
        if len(anchors) > 1:
            near = np.flatnonzero(rng.uniform(size=m) < around)
            q[near] = _around(len(near), anchors, limits, rng)
        q = q[free(q)]
        pairs = len(q) // 2
        cost = impact(q[: 2 * pairs]).reshape(pairs, 2)
        chosen = np.argmin(cost, axis=1)
        q = q[: 2 * pairs].reshape(pairs, 2, -1)[np.arange(pairs), chosen]
        found.append(q)
        count += len(q)
    return np.concatenate([np.zeros((0, len(lower))), *found])[:n]


def _around(n: int, anchors: Array, limits: tuple[Array, Array], rng: np.random.Generator) -> Array:
    a, b = (anchors[rng.integers(len(anchors), size=n)] for _ in range(2))
    t = rng.uniform(size=(n, 1))
    lower, upper = limits
    spread = 0.25 * np.linalg.norm(upper - lower) * rng.uniform(size=(n, 1)) ** 2 / np.sqrt(len(lower))
    return np.clip((1.0 - t) * a + t * b + spread * rng.normal(size=(n, len(lower))), lower, upper)


def nearest(q: Float[Array, "m nq"], nodes: Float[Array, "node nq"], k: int) -> Int[Array, "m k"]:
    """Return the k nearest nodes of each configuration, by ascending distance; a node is none of its own."""
    k = min(k, len(nodes))
    found = [np.zeros((0, k), dtype=int)]
    squares = np.einsum("ij,ij->i", nodes, nodes)
    for begin in range(0, len(q), _BLOCK):
        block = q[begin : begin + _BLOCK]
        distance = squares - 2.0 * block @ nodes.T
        near = np.argpartition(distance, k - 1, axis=1)[:, :k]
        order = np.argsort(np.take_along_axis(distance, near, axis=1), axis=1, kind="stable")
        found.append(np.take_along_axis(near, order, axis=1))
    return np.concatenate(found)


def neighbour_edges(nodes: Float[Array, "node nq"], k: int) -> Int[Array, "edge 2"]:
    """Join every node to its k nearest; rows (i, j) with i < j, each once, by ascending j."""
    near = nearest(nodes, nodes, k + 1)
    i, j = np.repeat(np.arange(len(nodes)), near.shape[1]), near.ravel()
    pairs = np.unique(np.stack([np.maximum(i, j), np.minimum(i, j)], axis=1)[i != j], axis=0)
    return pairs[:, ::-1]

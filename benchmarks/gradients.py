"""Gradients of the planners' terms against finite differences, scene by scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import suite
from benchmarks.clearance_twin import ClearanceTwin
from graceful_plan.compare.problems.analytic import analytic_problems
from graceful_plan.core.compile import compile_scene
from graceful_plan.planners.planner import DifferentiableObjective

Array = np.ndarray

STEPS = (1e-5, 1e-6, 1e-7)
"""Of the differences [rad]; the one that agrees best counts, for rounding spoils the short ones and kinks the long."""
KINK = 1e-3
"""Difference of the slopes ahead and behind, relative to the gradient, from which on there is a kink."""
EDGE = 0.05
"""Length of the edges per joint, about that of an optimiser's [rad]."""
CLEAR = 0.15
"""Clearances are looked at within this distance [m]."""


@dataclass(frozen=True, kw_only=True)
class SlopeCheck:
    """How well a gradient agrees."""

    term: str
    where: str
    count: int
    """Points compared."""
    worst: float
    """Largest error, relative to the norm of the gradient."""
    kinks: int = 0
    """Points left out because the slopes ahead and behind differ."""


def examine(task: str, n: int, seed: int = 0) -> list[SlopeCheck]:
    """Compare every term of one task, at random points near its start and goals and anywhere."""
    instance = suite.task(task)
    rng = np.random.default_rng(seed)
    lower, upper = instance.scene.limits.position.T
    ends = np.concatenate([instance.start[None], instance.goal])
    place = rng.uniform(size=(n, 1))
    between = (1.0 - place) * ends[0] + place * ends[rng.integers(1, len(ends), n)]
    q = np.clip(between + 0.2 * rng.normal(size=between.shape), lower, upper)
    objective = gp.Objective(w=1.0).bind(instance.scene)
    return [*_of_edges(objective, q, task, rng), *_of_clearance(instance.scene, _spread(q, rng, lower, upper), task)]


def analytic(n: int, seed: int = 0) -> Iterator[SlopeCheck]:
    """Compare the derivatives of the problems with known optima, where they have any."""
    rng = np.random.default_rng(seed)
    for name, instance in analytic_problems().items():
        problem = instance.problem
        q = rng.uniform(problem.lower, problem.upper, (n, len(problem.start)))
        yield from _of_edges(instance.objective, q, name, rng)


def _spread(q: Array, rng: np.random.Generator, lower: Array, upper: Array) -> Array:
    """As many again anywhere within the limits: there an arm meets itself."""
    return np.concatenate([q, rng.uniform(lower, upper, (10 * len(q), len(lower)))])


def _of_edges(objective: object, q0: Array, where: str, rng: np.random.Generator) -> Iterator[SlopeCheck]:
    q1 = q0 + EDGE * rng.normal(size=q0.shape)
    found = objective.edge_gradients(q0, q1) if isinstance(objective, DifferentiableObjective) else None
    if found is None or not isinstance(objective, DifferentiableObjective):
        return
    nq = q0.shape[1]

    def total(ends: Array) -> Array:
        cost = objective.edges(np.ascontiguousarray(ends[:, :nq]), np.ascontiguousarray(ends[:, nq:]))
        return cost[:, 0] + objective.w * cost[:, 1]

    gradient = np.concatenate(found[1:], axis=1)
    yield compared("edges, V + w S", where, total, np.concatenate([q0, q1], axis=1), gradient)


def _of_clearance(scene: gp.Scene, q: Array, where: str) -> Iterator[SlopeCheck]:
    kernels = compile_scene(scene).kernels
    twin = ClearanceTwin(kernels.robot, kernels.world)
    clearance, gradient = kernels.clearance_gradient(q)
    distances = twin.distances(q)
    near = distances.argmin(axis=1)
    seconds = np.partition(distances, 1, axis=1)[:, 1] if distances.shape[1] > 1 else np.full(len(q), np.inf)
    known = np.abs(distances.min(axis=1) - clearance) < 1e-4  # else the nearest is something that the twin leaves out
    alone = seconds - distances.min(axis=1) > 1e-5  # two equally near: either's gradient will do
    among = known & alone & (np.abs(clearance) < CLEAR)
    own = near >= distances.shape[1] - twin.n_self
    for term, which in (("clearance, surroundings", among & ~own), ("clearance, self", among & own)):
        rows = np.flatnonzero(which)[:100]
        if len(rows):
            pair = near[rows]

            def distance(points: Array, pair: Array = pair) -> Array:
                return twin.distance(points, np.tile(pair, len(points) // len(pair)))

            yield compared(term, where, distance, q[rows], gradient[rows])


def compared(term: str, where: str, f: Callable[[Array], Array], x: Array, gradient: Array) -> SlopeCheck:
    """Compare a gradient with differences of f, which takes points [m n, nx] whose rows repeat those of x in order."""
    size = np.maximum(np.linalg.norm(gradient, axis=1), 1e-3 * np.linalg.norm(gradient, axis=1).max() + 1e-12)
    error = np.min([np.linalg.norm(gradient - _central(f, x, h), axis=1) for h in STEPS], axis=0) / size
    kink = np.linalg.norm(_central(f, x, STEPS[-1], one_sided=True), axis=1) > KINK * size
    smooth = ~kink
    worst = float(error[smooth].max()) if smooth.any() else np.inf
    return SlopeCheck(term=term, where=where, count=int(smooth.sum()), worst=worst, kinks=int(kink.sum()))


def _central(f: Callable[[Array], Array], x: Array, h: float, *, one_sided: bool = False) -> Array:
    """Slopes of f to fourth order [n, nx]; or by how much those ahead and behind differ."""
    n, nx = x.shape
    moves = h * np.eye(nx)

    def at(k: float) -> Array:
        return f((x[None] + k * moves[:, None]).reshape(-1, nx)).reshape(nx, n).T

    if one_sided:
        return (at(1.0) - 2.0 * at(0.0) + at(-1.0)) / h
    return (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * h)

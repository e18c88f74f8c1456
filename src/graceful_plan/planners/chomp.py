"""CHOMP: descent of a whole path along exact gradients, in a metric of smooth paths.

Steps of one path spread smoothly over it (`covariant.py`); what goes down is the path's energy in a metric that is
stretched by the impact and by a potential of the obstacles (`path_energy.py`).

References:
    Ratliff et al., "CHOMP: gradient optimization techniques for efficient motion planning", ICRA 2009.
    Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013. Differs in: the cost of
        a failure besides that of obstacles, vertices spread by what edges cost, exact derivatives of the sums, a line
        search, and only free paths are returned.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.covariant import Descent
from graceful_plan.planners.edge_derivatives import Slopes
from graceful_plan.planners.optimiser import Optimiser
from graceful_plan.planners.path_energy import Evaluation, ObstaclePotential, PathEnergy
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.planners.questions import Interrupted
from graceful_plan.planners.settings import count, positive
from graceful_plan.planners.smoothness import Smoothness

Array = np.ndarray

METHODS = ("lbfgs", "gradient")
"""Words for how CHOMP goes down."""
_LEAST_GAIN = 1e-6
"""Relative fall of J that counts as an improvement of the incumbent."""
_SETTLED = 1e-5
"""Relative fall of the energy below which a step counts as idle."""
_IDLE = 3
"""Idle steps in a row that end a descent."""


@dataclass(frozen=True, kw_only=True)
class CHOMP(Optimiser):
    """Improves a path along the gradient of J, in the metric of smooth paths.

    One iteration is one evaluation of a whole path with its gradient.
    """

    name: ClassVar[str] = "chomp"

    points: int = 48
    method: str = "lbfgs"
    memory: int = 8
    widths: tuple[float, ...] = ()
    stage_iterations: int = 15
    obstacle_weight: float = 50.0
    obstacle_reach: float = 0.02
    obstacle_step: float = 0.05
    longest_step: float = 0.3
    kick: float = 0.1

    def __post_init__(self) -> None:
        count("points", self.points, 2)
        count("memory", self.memory)
        count("stage_iterations", self.stage_iterations)
        for name in ("obstacle_weight", "obstacle_reach", "obstacle_step", "longest_step"):
            positive(name, getattr(self, name))
        if self.method not in METHODS:
            raise SettingError("method", self.method, f"one of {', '.join(METHODS)}")

    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths."""
        slopes = Slopes(problem, objective, budget)
        kept = Kept(path, slopes, self.points)
        start = kept.q
        if len(start) < 3:
            return
        metric = Smoothness(len(start) - 2, 1)
        potential = ObstaclePotential(weight=self.obstacle_weight, reach=self.obstacle_reach, step=self.obstacle_step)
        with suppress(Interrupted):
            q = start
            while not budget.exhausted:
                for width in [*self.widths, 0.0]:
                    wide = objective if width == 0.0 else objective.widened(width)
                    energy = PathEnergy(Slopes(problem, wide, budget), potential)
                    descent = Descent(energy, metric, (problem.lower, problem.upper), self.memory if self.method == "lbfgs" else 0, self.longest_step)
                    if not budget.spend():
                        return
                    descent.begin(energy(q))
                    idle = spent = 0
                    while idle < _IDLE and budget.spend():
                        before = descent.at.energy
                        taken = descent.attempt()
                        spent += 1
                        if taken is None or (width > 0.0 and spent >= self.stage_iterations):
                            break
                        if taken:
                            idle = 0 if descent.at.energy < before * (1.0 - _SETTLED) else idle + 1
                            if width == 0.0:
                                yield from kept.offer(descent.at)
                    q = descent.at.q
                    if width == 0.0:
                        yield from kept.repaired(descent.at)
                if not self.kick:
                    return
                q = kept.q.copy()
                q[1:-1] += self.kick * metric.noise(1, q.shape[1], rng)[0]
                q[1:-1] = metric.into_limits(q[1:-1], problem.lower, problem.upper)


class Kept:
    """The best free path so far, as many points as those that are tried."""

    def __init__(self, path: Path, slopes: Slopes, points: int) -> None:
        self.slopes = slopes
        self.q = with_points(path, points)
        self.total = np.inf
        if self._free(self.q).all():
            self.total = slopes.path_cost(path)

    def _free(self, q: Array) -> Array:
        return self.slopes.edges_free(q[:-1], q[1:])

    def offer(self, at: Evaluation) -> Iterator[Path]:
        if at.total < self.total * (1.0 - _LEAST_GAIN) and self._free(at.q).all():
            self.q, self.total = at.q, at.total
            yield Path(at.q)

    def repaired(self, at: Evaluation) -> Iterator[Path]:
        if not np.isfinite(self.total) or at.total >= self.total * (1.0 - _LEAST_GAIN):
            return
        q = self.blended(at.q)
        if q is None:
            return
        total = self.slopes.path_cost(Path(q))
        if total < self.total * (1.0 - _LEAST_GAIN):
            self.q, self.total = q, total
            yield Path(q)

    def blended(self, q: Array) -> Array | None:
        share = np.ones(len(q))
        for _ in range(8):
            tried = self.q + share[:, None] * (q - self.q)
            free = self._free(tried)
            if free.all():
                return tried
            blocked = np.flatnonzero(~free)
            near = np.minimum(np.abs(np.arange(len(q))[:, None] - blocked), np.abs(np.arange(len(q))[:, None] - blocked - 1)).min(axis=1)
            share = np.minimum(share, np.where(near == 0, 0.5 * share, np.minimum(1.0, share[blocked].min() * 0.5 + near / 6)))
        return None


def with_points(path: Path, edges: int) -> Float[Array, "point nq"]:
    q = path.without_duplicates().q
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    if len(q) < 2:
        return q
    if len(lengths) > edges:
        arc = np.concatenate([[0.0], np.cumsum(lengths)])
        s = np.linspace(0.0, arc[-1], edges + 1)
        return np.stack([np.interp(s, arc, column) for column in q.T], axis=1)
    pieces = np.ones(len(lengths), dtype=int)
    while pieces.sum() < edges:
        pieces[np.argmax(lengths / pieces)] += 1
    parts = [a + np.arange(k)[:, None] / k * (b - a) for a, b, k in zip(q[:-1], q[1:], pieces, strict=True)]
    return np.concatenate([*parts, q[-1:]])

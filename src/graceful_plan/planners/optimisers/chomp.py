"""CHOMP: gradient descent of a whole path in a metric of smooth paths.

A step spreads smoothly over the whole path (`covariant.py`). The minimised function is the energy of the path in a
metric that is stretched by the impact and by a potential of the obstacles (`path_energy.py`).

The impact of hitting an entity rises within about a centimetre, and its gradient is zero farther away. So a descent
begins with places of impact blurred over decimetres, and continues in stages down to the actual objective: the early
stages select the local minimum, the last one converges to it. Only costs without blur count.

References:
    Ratliff et al., "CHOMP: gradient optimization techniques for efficient motion planning", ICRA 2009.
    Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013. Differs in: the impact
        of failures is added to the cost of obstacles, vertices are spaced by the costs of edges, derivatives of the
        sums are exact, L-BFGS and a line search replace fixed steps, and only free paths are returned.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.interruptible import Interrupted
from graceful_plan.planners.optimisers.covariant import Descent
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.optimiser import Optimiser
from graceful_plan.planners.optimisers.path_energy import ObstaclePotential, PathEnergy
from graceful_plan.planners.optimisers.workpiece import JITTER, DescentState
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.setting_checks import count, positive_or_none

METHODS = ("lbfgs", "gradient")
"""Names of descent methods."""
_SETTLED = 1e-5
"""Relative decrease of the energy below which a step counts as idle."""
_IDLE = 4
"""Consecutive idle steps that end a descent."""
_FIRMER = 5.0
"""Factor on the obstacle weight if a path has converged in collision."""
_FIRMINGS = 3
"""Largest number of increases of the obstacle weight."""


@final
@dataclass(frozen=True, kw_only=True)
class CHOMP(Optimiser):
    """Improves a path along the gradient of J, in the metric of smooth paths.

    One iteration is one evaluation of a whole path with its gradient. After a descent has converged, the next one
    begins at the best path plus a smooth random displacement, called bend.

    Args:
        edges: Number of edges of the path during optimisation.
        method: "lbfgs", or "gradient" for the plain covariant gradient.
        memory: Number of steps that L-BFGS stores.
        widths: Blur of places of impact in the stages before the last one [m]; () for the last stage only.
        stage_iterations: Iterations of each of these stages.
        obstacle_weight: Cost of obstacles per length of path and per missing clearance [1/m].
        obstacle_reach: Clearance from which on obstacles cost nothing [m].
        obstacle_step: Largest distance between samples of the clearance along an edge [rad].
        longest_step: Largest move of a joint of any point in one iteration [rad].
        bend: Largest standard deviation along a bend [rad]; None to end after the first descent.
    """

    name: ClassVar[str] = "chomp"

    edges: int = 48
    method: str = "lbfgs"
    memory: int = 8
    widths: tuple[float, ...] = (0.2, 0.06)
    stage_iterations: int = 12
    obstacle_weight: float = 500.0
    obstacle_reach: float = 0.01
    obstacle_step: float = 0.05
    longest_step: float = 0.3
    bend: float | None = 0.15

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("edges", self.edges, 2)
        count("memory", self.memory)
        count("stage_iterations", self.stage_iterations)
        for name in ("obstacle_weight", "obstacle_reach", "obstacle_step", "longest_step", "bend"):
            positive_or_none(name, getattr(self, name))
        if self.method not in METHODS:
            raise SettingError("method", self.method, f"one of {', '.join(map(repr, METHODS))}")
        if not isinstance(self.widths, tuple):
            raise SettingError("widths", self.widths, "several widths [m]: (0.2, 0.06)")
        for width in self.widths:
            positive_or_none("widths", width)

    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost."""
        with suppress(Interrupted):
            piece = DescentState(path, self.edges, Slopes(problem, objective, budget))
            descents, bend = _Descents(self, piece), JITTER
            while piece.movable and not budget.exhausted:
                yield from descents.descend(piece.bent(bend, rng))
                if self.bend is None:
                    return
                bend = self.bend


@final
class _Descents:
    """Descents of one path, in stages with decreasing blur."""

    def __init__(self, settings: CHOMP, piece: DescentState) -> None:
        self.settings, self.piece = settings, piece
        self.slopes, self.kept, self.budget = piece.slopes, piece.kept, piece.budget
        problem = piece.slopes.problem
        self.stages = [Slopes(problem, stage, piece.budget) for stage in piece.widened(settings.widths)]

    def descend(self, q: Float[Array, "point nq"]) -> Iterator[Path]:
        """Descend from a path through all stages; yield improvements."""
        for slopes in self.stages:
            total = np.inf
            for descent in self._steps(q, slopes, self._potential(), self.settings.stage_iterations):
                q = descent.at.q
                total = self.slopes.path_cost(Path(q))  # without blur
                yield from self.kept.offer(q, total)
            yield from self.kept.approach(q, total)
        known = self.slopes.clearance_slopes(q[:1]) is not None
        for firmings in range(_FIRMINGS + 1 if known else 1):
            before, total = self.kept.total, np.inf
            for descent in self._steps(q, self.slopes, self._potential(_FIRMER**firmings), None):
                q, total = descent.at.q, descent.at.total
                yield from self.kept.offer(q, total)
            yield from self.kept.approach(q, total)
            if self.kept.total < before or self.slopes.edges_free(q[:-1], q[1:]).all():
                return

    def _potential(self, factor: float = 1.0) -> ObstaclePotential:
        chosen = self.settings
        return ObstaclePotential(
            weight=factor * chosen.obstacle_weight, reach=chosen.obstacle_reach, step=chosen.obstacle_step
        )

    def _steps(
        self, q: Float[Array, "point nq"], slopes: Slopes, potential: ObstaclePotential, most: int | None
    ) -> Iterator[Descent]:
        """Yield after every step, until the descent has converged or the iterations of the stage are used up."""
        chosen, idle, spent = self.settings, 0, 1
        if not self.budget.spend():
            return
        energy = PathEnergy(slopes, potential)
        memory = chosen.memory if chosen.method == "lbfgs" else 0
        # A long step can jump through a thin obstacle, and the potential does not bring the path back.
        allowed = self.kept.is_free if self.kept.is_free(q) else None
        descent = Descent(energy, self.piece.metric, self.piece.limits, memory, chosen.longest_step, allowed)
        descent.begin(energy(q))
        yield descent
        while idle < _IDLE and (most is None or spent < most) and self.budget.spend():
            before = descent.at.energy
            taken = descent.attempt()
            spent += 1
            if taken is None:
                return
            if taken:
                idle = 0 if descent.at.energy < before * (1.0 - _SETTLED) else idle + 1
                yield descent

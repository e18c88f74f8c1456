"""CHOMP: descent of a whole path along exact gradients, in a metric of smooth paths.

A step spreads smoothly over the whole path (`covariant.py`); what goes down is the path's energy in a metric that is
stretched by the impact and by a potential of the obstacles (`path_energy.py`).

Hazards have borders a centimetre wide, and a gradient says nothing about what lies beyond. So a descent begins with
hits smeared over decimetres, and goes on in stages to the width of the objective itself: the valley is found first and
its bottom last. Only costs at that last width count.

References:
    Ratliff et al., "CHOMP: gradient optimization techniques for efficient motion planning", ICRA 2009.
    Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013. Differs in: the cost of
        a failure besides that of obstacles, vertices spread by what edges cost, exact derivatives of the sums, L-BFGS
        and a line search instead of fixed steps, and only free paths are returned.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.optimisers.covariant import Descent
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.optimiser import Optimiser
from graceful_plan.planners.optimisers.path_energy import ObstaclePotential, PathEnergy
from graceful_plan.planners.optimisers.workpiece import JITTER, Workpiece
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.planners.questions import Interrupted
from graceful_plan.planners.settings import count, positive

Array = np.ndarray

METHODS = ("lbfgs", "gradient")
"""Words for how CHOMP goes down."""
_SETTLED = 1e-5
"""Relative fall of the energy below which a step counts as idle."""
_IDLE = 4
"""Idle steps in a row that end a descent."""
_FIRMER = 5.0
"""Factor on the weight of obstacles if a path has settled in one."""
_FIRMINGS = 3
"""How often."""


@final
@dataclass(frozen=True, kw_only=True)
class CHOMP(Optimiser):
    """Improves a path along the gradient of J, in the metric of smooth paths.

    One iteration is one evaluation of a whole path with its gradient. When a descent has settled, another one begins
    at the best path with a random bend.

    Args:
        edges: How many edges a path has while it is worked on.
        method: "lbfgs", or "gradient" for the plain covariant gradient.
        memory: How many steps L-BFGS remembers.
        widths: How far hits are smeared in the stages before the last [m]; () to do without.
        stage_iterations: Iterations of each of these stages.
        obstacle_weight: What obstacles charge per length, per clearance that is missing [1/m].
        obstacle_reach: Clearance from which on they charge nothing [m].
        obstacle_step: Largest distance between samples of the clearance along an edge [rad].
        longest_step: No joint of any point moves farther in one iteration [rad].
        bend: Standard deviation of a random bend at its highest [rad]; None to end when the first descent has settled.
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
        count("edges", self.edges, 2)
        count("memory", self.memory)
        count("stage_iterations", self.stage_iterations)
        for name in ("obstacle_weight", "obstacle_reach", "obstacle_step", "longest_step", "bend"):
            positive(name, getattr(self, name))
        if self.method not in METHODS:
            raise SettingError("method", self.method, f"one of {', '.join(map(repr, METHODS))}")
        if not isinstance(self.widths, tuple):
            raise SettingError("widths", self.widths, "several widths [m]: (0.2, 0.06)")
        for width in self.widths:
            positive("widths", width)

    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths."""
        with suppress(Interrupted):
            piece = Workpiece(path, self.edges, Slopes(problem, objective, budget))
            descents, bend = _Descents(self, piece), JITTER
            while piece.movable and not budget.exhausted:
                yield from descents.descend(piece.bent(bend, rng))
                if self.bend is None:
                    return
                bend = self.bend


@final
class _Descents:
    """Descents of one path, through stages whose hits are ever narrower."""

    def __init__(self, settings: CHOMP, piece: Workpiece) -> None:
        self.settings, self.piece = settings, piece
        self.slopes, self.kept, self.budget = piece.slopes, piece.kept, piece.budget
        problem = piece.slopes.problem
        self.stages = [Slopes(problem, stage, piece.budget) for stage in piece.widened(settings.widths)]

    def descend(self, q: Float[Array, "point nq"]) -> Iterator[Path]:
        """Go down from a path through all stages."""
        for slopes in self.stages:
            total = np.inf
            for descent in self._steps(q, slopes, self._potential(), self.settings.stage_iterations):
                q = descent.at.q
                total = self.slopes.path_cost(Path(q))  # not smeared
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
        """Yield after every step, until the path has settled or the iterations of the stage are over."""
        chosen, idle, spent = self.settings, 0, 1
        if not self.budget.spend():
            return
        energy = PathEnergy(slopes, potential)
        memory = chosen.memory if chosen.method == "lbfgs" else 0
        # A long step can jump through something thin, and no potential brings a path back from there.
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

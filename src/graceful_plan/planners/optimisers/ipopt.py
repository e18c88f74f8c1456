"""Direct transcription of a path: IPOPT moves all of its points at once, within joint limits and clear of obstacles.

CHOMP combines cost and obstacles in one energy. Here the cost is J itself and obstacles are constraints, so no weight
has to be tuned for paths along obstacles. As in CHOMP, solves begin with places of impact blurred over decimetres,
since the impact of hitting an entity rises within about a centimetre and its gradient is zero farther away.

`CasADi` optimises paths; `graceful_plan.optimise_trajectory` optimises path and timing together.

References:
    [Waechter2006] On the implementation of an interior-point filter line-search algorithm for large-scale nonlinear
    programming, Mathematical Programming 106.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.interruptible import Interrupted
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.nlp import Values, minimise
from graceful_plan.planners.optimisers.optimiser import Optimiser
from graceful_plan.planners.optimisers.path_program import PathProgram
from graceful_plan.planners.optimisers.workpiece import JITTER, DescentState
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.setting_checks import count, positive_or_none

_SETTLED, _IDLE = 1e-4, 10
"""Relative decrease of J below which an iteration counts as idle, and number of consecutive ones that end a solve."""
_WORTH = 1e-3
"""Relative decrease of J in a solve from which on the next solve continues from its result."""
_BARRIER = 1e-3
"""IPOPT's initial barrier parameter; it is small since the initial path is good already."""
_NEARLY = 1e-3
"""Largest constraint violation of an iterate that is checked."""


@final
@dataclass(frozen=True, kw_only=True)
class CasADi(Optimiser):
    """Improves a path by direct transcription with IPOPT, through CasADi.

    One iteration is one of IPOPT's. After a solve has converged, the next one begins at the best path plus a smooth
    random displacement, called bend. If a problem does not provide clearances, colliding paths are only discarded.

    Args:
        edges: Number of edges of the path during optimisation.
        widths: Blur of places of impact in the solves before the last one [m]; () for the last solve only.
        stage_iterations: Iterations of each of these solves.
        solve_iterations: Iterations of the last solve.
        memory: Number of steps in IPOPT's approximation of the Hessian.
        reach: Largest move of a joint of any point in one solve [rad or m].
        clearance: Clearance in addition to the problem's margin, for the path between two constrained points [m].
        spacing: Largest distance between points of an edge at which the clearance is a constraint [rad].
        bend: Largest standard deviation along a bend [rad]; None to end when solves no longer improve the path.
    """

    name: ClassVar[str] = "casadi"

    edges: int = 40
    widths: tuple[float, ...] = (0.3, 0.15, 0.07)
    stage_iterations: int = 15
    solve_iterations: int = 60
    memory: int = 10
    reach: float = 0.5
    clearance: float = 1e-3
    spacing: float = 0.05
    bend: float | None = 0.15

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("edges", self.edges, 2)
        count("stage_iterations", self.stage_iterations)
        count("solve_iterations", self.solve_iterations)
        count("memory", self.memory)
        for name in ("reach", "clearance", "spacing", "bend"):
            positive_or_none(name, getattr(self, name))
        for width in self.widths:
            positive_or_none("widths", width)

    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost."""
        with suppress(Interrupted):
            piece = DescentState(path, self.edges, Slopes(problem, objective, budget))
            if piece.movable:
                yield from self._solves(piece, rng)

    def _solves(self, piece: DescentState, rng: np.random.Generator) -> Iterator[Path]:
        """Solve from the path, repeat from the result while that helps, then solve from bent paths."""
        solves = _Solves(self, piece)
        bend, stages = JITTER, bool(solves.stages)
        while not piece.budget.exhausted:
            before = piece.kept.total
            yield from solves.solve(piece.bent(bend, rng), stages)
            if stages or piece.kept.total < before * (1.0 - _WORTH):
                bend, stages = JITTER, False
            elif self.bend is None:
                return
            else:
                bend, stages = self.bend, bool(solves.stages)


@final
class _Solves:
    """Solves of one path, and the improvements that they find."""

    def __init__(self, settings: CasADi, piece: DescentState) -> None:
        self.settings, self.slopes, self.kept, self.budget = settings, piece.slopes, piece.kept, piece.budget
        self.stages = piece.widened(settings.widths)
        self.found: list[Path] = []

    def solve(self, q: Float[Array, "point nq"], stages: bool) -> Iterator[Path]:
        """Solve from a path, through all stages or only the last, and yield the best improvement."""
        self.found = []
        with suppress(Interrupted):
            for stage in self.stages if stages else ():
                q = self._minimised(q, stage, self.settings.stage_iterations, last=False)
                self.found += self.kept.approach(q, self.slopes.path_cost(Path(q)))
            q = self._minimised(q, self.slopes.objective, self.settings.solve_iterations, last=True)
            self.found += self.kept.approach(q, self.slopes.path_cost(Path(q)))
        if self.found:
            yield self.found[-1]

    def _minimised(self, q: Array, objective: BoundObjective, iterations: int, last: bool) -> Array:
        slopes = Slopes(self.slopes.problem, objective, self.budget)
        total = slopes.path_cost(Path(q))
        its = self.settings
        program = PathProgram(q, slopes, its.clearance, its.spacing, total, its.reach)
        watched = _Watch(program, self, last)
        solution = minimise(
            program,
            program.first,
            watched,
            iterations=iterations,
            tolerance=1e-5,
            settings={"limited_memory_max_history": its.memory, "mu_init": _BARRIER},
        )
        return program.path(solution.x if watched.best is None else watched.best)


@final
class _Watch:
    """Spends the budget, keeps free iterates that are better, and ends a solve that has converged."""

    def __init__(self, program: PathProgram, solves: _Solves, last: bool) -> None:
        self.program, self.solves, self.last = program, solves, last
        self.best: Array | None = None
        self._cost, self._idle = np.inf, 0

    def __call__(self, x: Float[Array, " variable"], values: Values) -> bool:
        if not self.solves.budget.spend():
            return True
        self._idle += 1
        broken = np.maximum(self.program.least - values.constraints, values.constraints - self.program.most)
        if np.any(broken > _NEARLY):
            return False
        if self.last:
            self._offer(self.program.path(x), values.cost)
        if values.cost < self._cost:
            if values.cost < self._cost * (1.0 - _SETTLED):
                self._idle = 0
            self._cost, self.best = values.cost, x.copy()
        return self._idle >= _IDLE

    def _offer(self, q: Float[Array, "point nq"], total: float) -> None:
        """Keep a path if it is better and free; its cost is evaluated again, since it is clamped to the limits."""
        kept = self.solves.kept
        if total < kept.total:
            self.solves.found += kept.offer(q, self.solves.slopes.path_cost(Path(q)))

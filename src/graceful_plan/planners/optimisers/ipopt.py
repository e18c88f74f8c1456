"""Direct transcription of a path: IPOPT moves all of its points at once, within joint limits and clear of obstacles.

What CHOMP folds into one energy stays apart here: the cost is J itself and obstacles are constraints, so that a path
along an obstacle needs no weight to be found.

Hazards have borders a centimetre wide, and a gradient says nothing about what lies beyond. So solves begin with hits
smeared over decimetres, as those of CHOMP do.

`CasADi` is about paths; `graceful_plan.optimise_trajectory` does the same to path and timing at once.

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

from graceful_plan.array_types import Float
from graceful_plan.path import Path
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.nlp import Values, minimise
from graceful_plan.planners.optimisers.optimiser import Optimiser
from graceful_plan.planners.optimisers.path_program import PathProgram
from graceful_plan.planners.optimisers.workpiece import JITTER, Workpiece
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.planners.questions import Interrupted
from graceful_plan.planners.settings import count, positive

Array = np.ndarray

_SETTLED, _IDLE = 1e-4, 10
"""Relative fall of J below which an iteration counts as idle, and how many of these in a row end a solve."""
_WORTH = 1e-3
"""Relative fall of J in a solve that makes it worthwhile to go on from there before anything else."""
_BARRIER = 1e-3
"""IPOPT's barrier parameter to begin with: the path is good already, so constraints need not be felt from afar."""
_NEARLY = 1e-3
"""How far a constraint may be broken by an iterate that is worth checking."""


@final
@dataclass(frozen=True, kw_only=True)
class CasADi(Optimiser):
    """Improves a path by direct transcription with IPOPT, through CasADi.

    One iteration is one of IPOPT's. When a solve has settled, another one begins at the best path with a random bend.
    Obstacles of problems that do not know their clearance stop a path, but do not guide it.

    Args:
        edges: How many edges a path has while it is worked on.
        widths: How far hits are smeared in solves before the last [m]; () to do without.
        stage_iterations: Iterations of each of these.
        solve_iterations: Of the last one.
        memory: How many steps IPOPT's approximation of the Hessian remembers.
        reach: How far a joint of a point may move in one solve [rad or m].
        clearance: Clearance to keep beyond that of the problem, for what lies between two constraints [m].
        spacing: Largest distance between points of an edge at which the clearance is a constraint [rad].
        bend: Standard deviation of a random bend at its highest [rad]; None to end when the first solve has settled.
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
        count("edges", self.edges, 2)
        count("stage_iterations", self.stage_iterations)
        count("solve_iterations", self.solve_iterations)
        count("memory", self.memory)
        for name in ("reach", "clearance", "spacing", "bend"):
            positive(name, getattr(self, name))
        for width in self.widths:
            positive("widths", width)

    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths."""
        with suppress(Interrupted):
            piece = Workpiece(path, self.edges, Slopes(problem, objective, budget))
            if piece.movable:
                yield from self._solves(piece, rng)

    def _solves(self, piece: Workpiece, rng: np.random.Generator) -> Iterator[Path]:
        """Solve from the path, on from there for as long as that is worthwhile, then from bent ones."""
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
    """Solves of one path, and what they find."""

    def __init__(self, settings: CasADi, piece: Workpiece) -> None:
        self.settings, self.slopes, self.kept, self.budget = settings, piece.slopes, piece.kept, piece.budget
        self.stages = piece.widened(settings.widths)
        self.found: list[Path] = []

    def solve(self, q: Float[Array, "point nq"], stages: bool) -> Iterator[Path]:
        """Solve from a path on, through all stages or the last alone, and yield the best of what was found."""
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
    """Spends the budget, keeps what is free and better, and ends a solve that has settled."""

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
        """Keep a path that is better and free; the cost of one that was cut off at limits is another one."""
        kept = self.solves.kept
        if total < kept.total:
            self.solves.found += kept.offer(q, self.solves.slopes.path_cost(Path(q)))

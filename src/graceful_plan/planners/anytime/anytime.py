"""Anytime search in the native core: paths from several sources, each improved by gradient descent or random moves.

RRT-Connect finds the first path. Further candidates come from small temporary roadmaps, from detours, and from
RRT-Connect restricted to regions of low impact or to costs below the best one. If the objective has a native gradient,
each candidate descends along it and is discarded once it is unlikely to become the best; the best path is polished.
Sources of recent improvements are used more often. Without a gradient, several candidates are refined side by side by
random moves, and the worse half is discarded repeatedly. `Auto`, the default, runs several of these searches at once.

References:
    Hauser and Zhou, "Asymptotically optimal planning by feasible kinodynamic planning in a state-cost space", T-RO,
        2016.
    Wilson et al., "AORRTC: almost-surely asymptotically optimal planning with RRT-Connect", RA-L 2025.
    Geraerts and Overmars, "Creating high-quality paths for motion planning", IJRR 2007 (per-joint shortcuts).
    Griewank and Toint, "Partitioned variable metric updates for large structured optimization problems", Numerische
        Mathematik 1982 (the descents).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.core import _native
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.native import native_space, run_slice, seed_from
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.setting_checks import count, positive_fraction


@final
@dataclass(frozen=True, kw_only=True)
class Anytime(Planner):
    """Improves its path until the budget ends, or until it is proven optimal: a free straight edge at w = 0.

    One iteration is one tree extension, one evaluation of a path with its gradient, one refinement move, or a slice of
    work on a roadmap.

    Args:
        range: Longest edge of the trees, as a fraction of the diagonal of the limits.
        spacing: Distance between vertices of a refined path, as a fraction of the diagonal of the limits.
        challengers: Number of paths that are refined side by side if there is no gradient.
        max_nodes: Number of nodes above which trees are discarded and restarted.
        descents: Whether to use the gradient if there is one.
        scouts: Whether to search for regions of low impact with roadmaps; only with descents.
    """

    name: ClassVar[str] = "anytime"
    anytime: ClassVar[bool] = True

    range: float = 0.08
    spacing: float = 0.018
    challengers: int = 8
    max_nodes: int = 10_000
    descents: bool = True
    scouts: bool = True

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_fraction("range", self.range)
        positive_fraction("spacing", self.spacing)
        count("challengers", self.challengers)
        count("max_nodes", self.max_nodes, 10)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost."""
        core = self.search(native_space(problem, objective), problem, rng)
        while not budget.exhausted and not core.optimal:
            if run_slice(core.run, budget):
                yield Path(core.path)

    def search(self, space: _native.Space, problem: Problem, rng: np.random.Generator) -> _native.Anytime:
        """Create the search in the core, without starting it."""
        return _native.Anytime(
            space,
            start=problem.start,
            goals=problem.goals,
            range=self.range * problem.extent,
            max_nodes=self.max_nodes,
            spacing=self.spacing * problem.extent,
            challengers=self.challengers,
            seed=seed_from(rng),
            descents=self.descents,
            scouts=self.scouts,
        )

"""The default planner: RRT-Connect for a first path, then search and refinement by J until the budget ends.

A planner of the AO-x family with J = V + w S as edge cost: RRT-Connect runs again and again with the incumbent's cost
as bound on cost-to-come plus distance-to-go, so that whatever it finds is better. Between these searches it refines the
incumbent and a few challengers from other homotopy classes by moves that are kept only if J falls and edges are free:
shortcuts, per-joint shortcuts, perturbed vertices, smooth bumps.

References:
    Hauser and Zhou, "Asymptotically optimal planning by feasible kinodynamic planning in a state-cost space", T-RO,
        2016.
    Wilson et al., "AORRTC: almost-surely asymptotically optimal planning with RRT-Connect", RA-L 2025.
    Geraerts and Overmars, "Creating high-quality paths for motion planning", IJRR 2007 (per-joint shortcuts).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan import _native
from graceful_plan.path import Path
from graceful_plan.planners.native import native_space, run_slice, seed_from
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.settings import count, positive_fraction
from graceful_plan.planners.trivial import start_is_goal


@dataclass(frozen=True, kw_only=True)
class Anytime(Planner):
    """Improves its path until the budget ends, or until it is proven optimal: a free straight edge at w = 0.

    One iteration is one tree extension or one refinement move.

    Args:
        range: Longest edge of the trees, as a fraction of the diagonal of the limits.
        spacing: Distance between vertices of a refined path, as a fraction of the diagonal of the limits.
        challengers: How many paths enter a contest.
        max_nodes: Trees are dropped and grown anew when they hold more nodes.
    """

    name: ClassVar[str] = "anytime"
    anytime: ClassVar[bool] = True

    range: float = 0.08
    spacing: float = 0.018
    challengers: int = 8
    max_nodes: int = 10_000

    def __post_init__(self) -> None:
        positive_fraction("range", self.range)
        positive_fraction("spacing", self.spacing)
        count("challengers", self.challengers)
        count("max_nodes", self.max_nodes, 10)

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths."""
        if start_is_goal(problem):
            yield Path(problem.start[None])
            return
        space = native_space(problem, objective)
        core = _native.Anytime(
            space,
            problem.start,
            problem.goals,
            self.range * problem.extent,
            self.max_nodes,
            self.spacing * problem.extent,
            self.challengers,
            seed_from(rng),
        )
        while not budget.exhausted and not core.optimal:
            if run_slice(core.run, budget):
                yield Path(core.path)

"""A* over positions and headings of a base, from coarse to fine, in the native core.

References:
    M. Likhachev, D. Ferguson, "Planning long dynamically feasible maneuvers for autonomous vehicles", IJRR 28 (2009).
    M. Likhachev, G. Gordon, S. Thrun, "ARA*: anytime A* with provable bounds on sub-optimality", NIPS 2003.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.planners.bases_only import of_a_base
from graceful_plan.mobile.planners.floor_theta_star import FloorThetaStar
from graceful_plan.mobile.planners.postures import postures
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.native import native_space, run_slice
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem, path_total
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.setting_checks import count, positive_or_none


@final
@dataclass(frozen=True, kw_only=True)
class DriveLattice(Planner):
    """Anytime search for paths of straight stretches and turns in place on successively finer lattices.

    Along a path, the arm keeps one posture while the base moves. It either keeps the start posture and moves at the
    goal, or takes the goal posture at the start. Motions refined from these paths move base and arm together. Where no
    lattice has a path, `FloorThetaStar` searches for one. One iteration expands one node.

    Args:
        cells: Lengths of a move of the base [m], one lattice after the other.
        weights: Weights of the heuristic, one search after the other on each lattice. A search with weight c finds a
            path that costs at most c times the best of its lattice. The weights decrease, and the last must be 1.
        max_nodes: Number of nodes above which a lattice is abandoned.
        moves_arm: Whether the arm may move while the base does, in motions near the paths.
    """

    name: ClassVar[str] = "drive_lattice"
    anytime: ClassVar[bool] = True
    drives: ClassVar[bool] = True

    cells: tuple[float, ...] = (0.2, 0.1, 0.05)
    weights: tuple[float, ...] = (2.5, 1.0)
    max_nodes: int = 2_000_000
    moves_arm: bool = True

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("max_nodes", self.max_nodes, 100)
        if not isinstance(self.moves_arm, bool):
            raise SettingError("moves_arm", self.moves_arm, "True or False")
        for cell in self.cells:
            positive_or_none("cells", cell)
        decreasing = all(a > b for a, b in zip(self.weights, self.weights[1:], strict=False))
        if not self.cells or not self.weights or self.weights[-1] != 1.0 or not decreasing:
            raise SettingError("weights", self.weights, "decreasing numbers, the last of them 1")

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost.

        Raises:
            SettingError: If the robot has no base.
        """
        charging, base = of_a_base(objective, self.name)
        best, short = np.inf, charging.objective.with_weight(0.0).bind(charging.scene, charging.paces)
        # The shortest path comes first: where impact decides, evaluating it everywhere takes time.
        searches = [(self.cells[0], short), *((cell, objective) for cell in self.cells)]
        for cell, with_impact in searches if objective.w > 0.0 else searches[1:]:
            for begin in postures(problem):
                for path in self._searched(begin, cell, base, (problem, with_impact, budget)):
                    if (total := path_total(objective, path)) < best:
                        best = total
                        yield path
        if best == np.inf:  # start, goal or the way between them may lie between the nodes of all lattices
            yield from FloorThetaStar().solve(problem, objective, budget, rng)

    def _searched(
        self, begin: Path, cell: float, base: DiffDrive, asked: tuple[Problem, BoundObjective, Budget]
    ) -> Iterator[Path]:
        """Search one lattice with decreasing weights of the heuristic."""
        problem, objective, budget = asked
        lattice = _native.Drive(
            native_space(problem, objective),
            start=np.ascontiguousarray(begin.q[-1]),
            goals=np.ascontiguousarray(problem.goals),
            cell=cell,
            reverse=base.reverse,
            max_nodes=self.max_nodes,
        )
        for weight in self.weights:
            lattice.begin(weight)
            found = False
            while not (found or lattice.over or budget.exhausted):
                found = run_slice(lattice.run, budget)
            if not found:
                return
            yield Path(np.concatenate([begin.q[:-1], lattice.path])).without_duplicates()

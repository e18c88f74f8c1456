"""A roadmap as a planner: its path first, then better ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.anytime.auto import Auto
from graceful_plan.planners.optimisers.optimiser import Optimiser
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.questions import out_of_time
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.trivial import start_is_goal
from graceful_plan.query.ends import Ends
from graceful_plan.roadmap.roadmap import Roadmap

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class RoadmapPlanner(Planner):
    """Takes the cheapest path of a roadmap and improves it until the budget ends.

    For `plan`, which times and verifies what comes out. It finds nothing where the roadmap is not connected. One
    iteration is the search in the roadmap, then what the optimiser or `Auto` says.

    Args:
        roadmap: Built in the scene of the plan; severities may differ.
        optimiser: What improves the path; None for `Auto`, which begins with it and also searches elsewhere.
        refine: Whether to improve it at all.

    Raises:
        SettingError: If the plan is for another scene or another objective than the roadmap.
    """

    name: ClassVar[str] = "roadmap"
    anytime: ClassVar[bool] = True

    roadmap: Roadmap
    optimiser: Optimiser | None = None
    refine: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.roadmap, Roadmap):
            raise SettingError("roadmap", self.roadmap, "a Roadmap, as Roadmap.build makes one")
        if self.optimiser is not None and not isinstance(self.optimiser, Optimiser):
            raise SettingError("optimiser", self.optimiser, "an Optimiser or None")

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the path of the roadmap, then better ones."""
        if not (isinstance(problem, SceneProblem) and isinstance(objective, SceneObjective)):
            raise SettingError("problem", problem, "one of a scene, as `plan` makes it")
        self._check(objective)
        if not budget.spend():
            return
        if start_is_goal(problem):
            yield Path(problem.start[None])
            return
        path = self._first(problem, objective, budget)
        if path is None:
            return
        if self.refine and self.optimiser is None:
            yield from Auto(initial=path).solve(problem, objective, budget, rng)  # the path itself comes first
            return
        yield path
        if self.refine and self.optimiser is not None:
            yield from self.optimiser.improve(path, problem, objective, budget, rng)

    def _check(self, objective: SceneObjective) -> None:
        """Refuse what the roadmap has no prices for. Weight and pace may differ: what is found is priced anew."""
        if objective.scene is not self.roadmap.scene:
            self.roadmap.check(objective.scene)
        own, asked = self.roadmap.objective, objective.objective
        if (own.motion, own.impact, own.exposure) != (asked.motion, asked.impact, asked.exposure):
            raise SettingError("objective", asked, f"one with the roadmap's costs, as {own}")

    def _first(self, problem: SceneProblem, objective: SceneObjective, budget: Budget) -> Path | None:
        """Find the cheapest path of the roadmap that is free at the clearance that this problem keeps."""
        goals = tuple(Path(goal[None]) for goal in problem.goals)
        start, compiled = Path(problem.start[None]), compile_scene(self.roadmap.scene)
        ends = Ends(compiled=compiled, departure=start, arrivals=goals, goal_index=tuple(range(len(goals))))
        joined = self.roadmap.joined(ends)
        severity = self.roadmap.severity(objective.scene)
        motion, impact = joined.costs(self.roadmap.impact(severity), severity)
        cost = motion + objective.w * impact
        while not out_of_time(budget):
            steps, _ = joined.graph.cheapest(cost, joined.start, joined.goals)
            if len(steps) == 0:
                return None
            free = problem.edges_free(*joined.ends_of(steps))
            if free.all():
                return joined.path(steps)
            cost[steps[~free]] = np.inf
        return None

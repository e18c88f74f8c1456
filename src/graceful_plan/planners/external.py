"""Adapter for planners of other libraries: a function from a plain description of a problem to a path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import ShapeError
from graceful_plan.path import Path, finite_array
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ExternalProblem:
    """Description of a problem without types of this library.

    | field       | meaning                                                                  | unit | shape   |
    |-------------|--------------------------------------------------------------------------|------|---------|
    | start       | first configuration                                                      | rad  | nq      |
    | goals       | configurations; the path has to end at one of them                       | rad  | goal nq |
    | lower       | lower position limits                                                    | rad  | nq      |
    | upper       | upper position limits                                                    | rad  | nq      |
    | joints      | names of the joints in the MJCF                                          |      |         |
    | mjcf        | robot and surroundings as XML, meshes by name; "" if there is no scene   |      |         |
    | states_free | optional collision test: returns which configurations [n, nq] are free   |      |         |
    | seconds     | remaining time                                                           | s    |         |
    | seed        | seed for random numbers                                                  |      |         |
    """

    start: Float[Array, " nq"]
    goals: Float[Array, "goal nq"]
    lower: Float[Array, " nq"]
    upper: Float[Array, " nq"]
    joints: tuple[str, ...]
    mjcf: str
    states_free: Callable[[Array], Bool[Array, " n"]]
    seconds: float
    seed: int


Adapter = Callable[[ExternalProblem], ArrayLike | None]
"""Returns the configurations of a path [n, nq], or None if it finds none."""


def planner_from_function(function: Adapter) -> type[Planner]:
    """Return a planner that calls a function once. Its paths are verified like those of any other planner."""

    @final
    @dataclass(frozen=True)
    class Adapted(Planner):
        name: ClassVar[str] = getattr(function, "__name__", "adapted")
        anytime: ClassVar[bool] = False

        def solve(
            self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
        ) -> Iterator[Path]:
            if not budget.spend():
                return
            found = function(_plain(problem, objective, budget, rng))
            if found is not None:
                q = finite_array(f"the result of {self.name}", found)
                if q.ndim != 2 or q.shape[1] != len(problem.start) or len(q) < 1:
                    raise ShapeError(f"the result of {self.name}", q.shape, f"(n, {len(problem.start)})")
                yield Path(q)

    Adapted.__module__ = function.__module__
    return Adapted


def _plain(problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator) -> ExternalProblem:
    scene: Any = objective.scene if isinstance(objective, SceneObjective) else None
    return ExternalProblem(
        start=problem.start.copy(),
        goals=problem.goals.copy(),
        lower=problem.lower.copy(),
        upper=problem.upper.copy(),
        joints=() if scene is None else scene.joints,
        mjcf="" if scene is None else scene.spec.to_xml(),
        states_free=problem.states_free,
        seconds=budget.remaining_seconds,
        seed=int(rng.integers(2**31)),
    )

"""Another library as a planner: a function from a plain description of a problem to a path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import ShapeError
from graceful_plan.path import Path, finite_array
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem

Array = np.ndarray


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PlainProblem:
    """What a library of any kind needs to know of a problem.

    | field       | meaning                                                                  | unit | shape   |
    |-------------|--------------------------------------------------------------------------|------|---------|
    | start       | first configuration                                                      | rad  | nq      |
    | goals       | configurations of which one is to be reached                             | rad  | goal nq |
    | lower       | lower position limits                                                    | rad  | nq      |
    | upper       | upper position limits                                                    | rad  | nq      |
    | joints      | their names in the MJCF                                                  |      |         |
    | mjcf        | robot and surroundings as XML; meshes by name only; "" if it is no scene |      |         |
    | states_free | tells which configurations [n, nq] are free, for who wants to use it     |      |         |
    | seconds     | time that is left                                                        | s    |         |
    | seed        | for random numbers                                                       |      |         |
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


Adapter = Callable[[PlainProblem], ArrayLike | None]
"""Returns the configurations of a path [n, nq], or None if it finds none."""


def adapted(function: Adapter) -> type[Planner]:
    """Return a planner that asks a function once. What it returns is judged like any other path."""

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
                q = finite_array(f"what {self.name} returns", found)
                if q.ndim != 2 or q.shape[1] != len(problem.start) or len(q) < 1:
                    raise ShapeError(f"what {self.name} returns", q.shape, f"(n, {len(problem.start)})")
                yield Path(q)

    Adapted.__module__ = function.__module__
    return Adapted


def _plain(problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator) -> PlainProblem:
    scene: Any = objective.scene if isinstance(objective, SceneObjective) else None
    return PlainProblem(
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

"""Gradient descents of single paths in the native core, for planners written in Python.

`Anytime` does this inside the core for many paths at once; stages and limits here are those of its challengers.
"""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem, out_of_time
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem

_COARSE, _FINE, _LAST = (14, 0.15), (40, 0.05), (100, 0.04)
"""Pieces of the path and distance between samples of the impact [rad]; `_LAST` is used if the fine path is not free."""
_COARSE_STEPS, _FINE_STEPS, _MORE_STEPS = 30, 100, 30
"""Evaluations of the coarse and the fine stage, and of each round for a path that is not free at the end."""
_HARDENINGS = 2
"""Largest number of rounds with a heavier clearance penalty for a path that is still not free."""
_SLICE = 5
"""Evaluations between two readings of the clock: 1 to 10 ms."""
_HOPELESS = 1.5
"""Ratio of a coarse path's cost to the best cost beyond which it is discarded."""
_HOPELESS_FINE = (30, 1.2)
"""Evaluations after which a fine path is compared with the best cost, and ratio beyond which it is discarded."""


@final
class NativeDescents:
    """Descends from paths along the gradient of J.

    Args:
        questions: Access to problem and objective.
        space: Problem and objective in the core, with gradients.
    """

    def __init__(self, questions: InterruptibleProblem, space: _native.Space) -> None:
        self._questions, self._space = questions, space

    @classmethod
    def of(cls, questions: InterruptibleProblem) -> NativeDescents | None:
        """Return the descents; None if the objective has no gradient, a weight of 0, or exposure by waypoints."""
        problem, objective = questions.problem, questions.objective
        if not (isinstance(problem, SceneProblem) and isinstance(objective, SceneObjective) and objective.w > 0.0):
            return None
        if objective.objective.exposure == "waypoints":
            return None
        slopes = objective.edge_gradients(problem.start[None], problem.goals[:1])
        return None if slopes is None else cls(questions, native_space(problem, objective))

    def lowered(self, path: Path, best: float) -> Path | None:
        """Descend from `path` and return the free final path; None if it is not free, or much worse than `best`.

        The descent uses no iterations of the budget, but ends with its time.

        Raises:
            Interrupted: If the time is over.
        """
        descent = self._run(self._descent(path.q, _COARSE), _COARSE_STEPS)
        if descent.value > _HOPELESS * best:
            return None
        steps, factor = _HOPELESS_FINE
        descent = self._run(self._descent(descent.path, _FINE), steps)
        if descent.value > factor * best:
            return None
        self._run(descent, _FINE_STEPS - steps)
        return self._landed(descent.path)

    def _landed(self, q: Float[Array, "vertex nq"]) -> Path | None:
        """Return a path if it is free, else a free one near it by a descent with more vertices; None if that fails."""
        if not self._is_free(q):
            descent = self._run(self._descent(q, _LAST), _MORE_STEPS)
            for _ in range(_HARDENINGS):
                if self._is_free(descent.path):
                    break
                descent.harden()
                self._run(descent, _MORE_STEPS)
            q = descent.path
        return Path(q).without_duplicates() if self._is_free(q) else None

    def _descent(self, q: Float[Array, "vertex nq"], fineness: tuple[int, float]) -> _native.Descent:
        return _native.Descent(self._space, np.ascontiguousarray(q), *fineness)

    def _run(self, descent: _native.Descent, steps: int) -> _native.Descent:
        for _ in range(0, steps, _SLICE):
            if out_of_time(self._questions.budget):
                raise Interrupted
            if descent.run(_SLICE) < _SLICE:
                break
        return descent

    def _is_free(self, q: Float[Array, "vertex nq"]) -> bool:
        return bool(self._questions.edges_free(q[:-1], q[1:]).all())

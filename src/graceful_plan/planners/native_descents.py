"""Descents of single paths in the native core, for planners in Python that find paths in other ways.

`Anytime` does the same within the core, with many paths at once: stages and limits are those of its challengers.
"""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core import _native
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.native import native_space
from graceful_plan.planners.questions import Interrupted, Questions, out_of_time
from graceful_plan.planners.scene_problem import SceneProblem

Array = np.ndarray

_COARSE, _FINE, _LAST = (14, 0.15), (40, 0.05), (100, 0.04)
"""Pieces of the path and distance between samples of the impact [rad]; the last where the fine path is not free."""
_COARSE_STEPS, _FINE_STEPS, _MORE_STEPS = 30, 100, 30
"""Evaluations while coarse, while fine, and each time that the path was not free in the end."""
_HARDENINGS = 2
"""How often a path that is still not free is pressed harder away from what is in the way."""
_SLICE = 5
"""Evaluations between two looks at the clock: 1 to 10 ms."""
_HOPELESS = 1.5
"""A coarse path that costs so many times the best one is given up."""
_HOPELESS_FINE = (30, 1.2)
"""The same for a fine one, after so many evaluations."""


@final
class NativeDescents:
    """Leads paths down along the gradient of J.

    Args:
        questions: To problem and objective.
        space: The same in the core, with slopes.
    """

    def __init__(self, questions: Questions, space: _native.Space) -> None:
        self._questions, self._space = questions, space

    @classmethod
    def of(cls, questions: Questions) -> NativeDescents | None:
        """Return descents, or None if there is no gradient of the objective, or if it counts the vertices of a path."""
        problem, objective = questions.problem, questions.objective
        if not (isinstance(problem, SceneProblem) and isinstance(objective, SceneObjective) and objective.w > 0.0):
            return None
        if objective.objective.exposure == "waypoints":
            return None
        slopes = objective.edge_gradients(problem.start[None], problem.goals[:1])
        return None if slopes is None else cls(questions, native_space(problem, objective))

    def lowered(self, path: Path, best: float) -> Path | None:
        """Return the free path that a descent from `path` ends with; None if it will not cost less than `best`.

        It does not spend the budget, but ends with its time.

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
        """Return a path as it is if it is free, else one near it that keeps away with more vertices, or None."""
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

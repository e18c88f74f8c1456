"""Inverse kinematics: configurations that bring the tool to a pose.

The core takes many seeds to the pose at once by damped least squares (`Kernels.reach`), as exactly as doubles allow.
Where no seed arrives, for instance because limits are in the way, mink's quadratic programs, which know the limits,
try those that ended nearest. Solutions are filtered by a test for collisions, and come sorted by their distance from
the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.query.endpoints.pose_solver import PoseSolver
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

Array = np.ndarray
FreeTest = Callable[[Array], Array]
"""Which of the configurations [n, nq] are free: bool [n]."""

_RETRIED = 4
"""Seeds that mink takes on where none arrived."""
_SAME = 0.1
"""Solutions that differ less than this in every joint [rad or m] are one."""


@dataclass(frozen=True, eq=False)
class IKResult:
    """What inverse kinematics found.

    | field             | meaning                                                 | unit     | shape       |
    |-------------------|---------------------------------------------------------|----------|-------------|
    | q                 | solutions, nearest to the start first, possibly none    | rad or m | solution nq |
    | position_error    | of the best configuration, free of collision or not     | m        |             |
    | orientation_error | of the same                                             | rad      |             |
    | colliding         | how many solutions were dropped because they collide    |          |             |
    """

    q: Float[Array, "solution nq"]
    position_error: float
    orientation_error: float
    colliding: int


def solve_ik(
    goal: PoseGoal,
    scene: Scene,
    start: ArrayLike,
    *,
    free: FreeTest | None = None,
    count: int = 8,
    seeds: int = 32,
    rounds: int = 3,
    iterations: int = 60,
    seed: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
) -> IKResult:
    """Find configurations within the position limits that reach a pose.

    Args:
        goal: The pose.
        scene: Robot and tool.
        start: Configuration to be near to; the first seed.
        free: Which configurations may be used; all by default.
        count: How many different solutions are enough.
        seeds: Seeds in a round; the next round is tried while there are fewer solutions than `count`.
        rounds: Rounds at most.
        iterations: Iterations from each seed at most.
        seed: Of the random numbers; the result depends on nothing else.
        cancelled: Asked all the time; when it says so, what was found until then is returned.
    """
    for name, value in (("count", count), ("seeds", seeds), ("rounds", rounds), ("iterations", iterations)):
        if value < 1:
            raise SettingError(name, value, "at least 1")
    q_start = finite_array("start", start, ndim=1, last=len(scene.joints))
    solver = PoseSolver(goal, scene, cancelled)
    rng = np.random.default_rng(seed)
    solutions = _Solutions(q_start, count, free, cancelled)
    missed: list[Array] = []
    best = (np.inf, np.inf)
    for number in range(rounds):
        if solutions.enough or cancelled():
            break
        found, ended = solver.search(draw_seeds(scene, q_start, seeds, rng, number), iterations)
        best = min(best, solver.errors(ended[0]), key=solver.badness)
        missed += [*ended[:_RETRIED]]
        solutions.add(found)
    if not solutions.looked_at and not cancelled():
        nearest = sorted(missed, key=lambda q: solver.badness(solver.errors(q)))[:_RETRIED]
        found, ended = solver.polish(np.array(nearest), iterations // 2)
        best = min(best, solver.errors(ended[0]), key=solver.badness)
        solutions.add(found)
    return IKResult(solutions.nearest_first[:count], *best, solutions.colliding)


@final
class _Solutions:
    """Different configurations at the pose that may be used.

    Args:
        start: What they should be near to.
        count: How many are enough.
        free: Which may be used; all if None.
        cancelled: Asked before each look at some of them.
    """

    def __init__(
        self, start: Float[Array, " nq"], count: int, free: FreeTest | None, cancelled: Callable[[], bool]
    ) -> None:
        self._start, self._count, self._free, self._cancelled = start, count, free, cancelled
        self._q = np.empty((0, len(start)))
        self.looked_at = self.colliding = 0

    @property
    def enough(self) -> bool:
        """Whether there are as many as are enough."""
        return len(self._q) >= self._count

    @property
    def nearest_first(self) -> Float[Array, "n nq"]:
        """All of them, from the nearest to the start on."""
        return self._sorted(self._q)

    def add(self, q: Float[Array, "n nq"]) -> None:
        """Look at configurations at the pose, from the nearest on, until there are enough."""
        left = self._sorted(q)
        while len(left) and not self.enough and not self._cancelled():
            some, left = left[: self._count], left[self._count :]
            good = np.ones(len(some), dtype=bool) if self._free is None else np.asarray(self._free(some), dtype=bool)
            self.looked_at += len(some)
            self.colliding += int((~good).sum())
            self._q = _distinct(np.concatenate([self._q, some[good]]))

    def _sorted(self, q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        return q[np.argsort(np.linalg.norm(q - self._start, axis=1), kind="stable")]


def draw_seeds(
    scene: Scene, start: Float[Array, " nq"], n: int, rng: np.random.Generator, number: int
) -> Float[Array, "n nq"]:
    """Draw seeds: around the start, farther out from seed to seed, and anywhere; keyframes and the start come first."""
    lower, upper = scene.limits.position.T
    near = start + rng.normal(size=(n // 2, len(start))) * np.linspace(0.1, 1.0, n // 2)[:, None]
    anywhere = rng.uniform(lower, upper, size=(n, len(start)))
    known = [start, *scene.keyframes.values()] if number == 0 else []
    return np.clip(np.array([*known, *near, *anywhere])[:n], lower, upper)


def _distinct(q: Float[Array, "n nq"]) -> Float[Array, "m nq"]:
    kept = q[:0]
    for configuration in q:
        if (np.abs(kept - configuration).max(axis=1) > _SAME).all():
            kept = np.concatenate([kept, configuration[None]])
    return kept

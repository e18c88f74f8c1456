"""Inverse kinematics: configurations that bring the tool to a pose.

The core iterates from many seeds at once by damped least squares (`Kernels.reach`), as exactly as doubles allow. If no
seed converges, for instance because of joint limits, mink's quadratic programs, which include the limits, continue from
the best seeds. Solutions that collide are discarded; the others are sorted by their distance from the start.
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
"""Returns which of the configurations [n, nq] are free: bool [n]."""

_RETRIED = 4
"""IK seeds that mink polishes if the batch search reaches the pose from none."""
_SAME = 0.1
"""Solutions that differ less than this in every joint [rad or m] count as one."""


@dataclass(frozen=True, eq=False)
class IKResult:
    """Result of inverse kinematics.

    | field             | meaning                                                 | unit     | shape       |
    |-------------------|---------------------------------------------------------|----------|-------------|
    | q                 | solutions, nearest to the start first, possibly none    | rad or m | solution nq |
    | position_error    | of the best configuration, even if it collides          | m        |             |
    | orientation_error | of the same configuration                               | rad      |             |
    | colliding         | number of solutions discarded because they collide      |          |             |
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
        scene: Scene with robot and tool.
        start: First seed; solutions near it come first.
        free: Test for free configurations; all are accepted by default.
        count: Number of distinct solutions that is enough.
        seeds: Seeds in a round; the next round follows if there are fewer solutions than `count`.
        rounds: Largest number of rounds.
        iterations: Largest number of iterations from each seed.
        seed: Seed of the random numbers; the result is deterministic.
        cancelled: Polled during the search; once it returns True, the solutions up to then are returned.
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
    """Distinct usable configurations at the pose.

    Args:
        start: Configuration that distances are measured from.
        count: Number of solutions that is enough.
        free: Test for free configurations; all are accepted if None.
        cancelled: Polled before each batch.
    """

    def __init__(
        self, start: Float[Array, " nq"], count: int, free: FreeTest | None, cancelled: Callable[[], bool]
    ) -> None:
        self._start, self._count, self._free, self._cancelled = start, count, free, cancelled
        self._q = np.empty((0, len(start)))
        self.looked_at = self.colliding = 0

    @property
    def enough(self) -> bool:
        """Whether there are `count` solutions."""
        return len(self._q) >= self._count

    @property
    def nearest_first(self) -> Float[Array, "n nq"]:
        """All solutions, nearest to the start first."""
        return self._sorted(self._q)

    def add(self, q: Float[Array, "n nq"]) -> None:
        """Check configurations at the pose, nearest to the start first, until there are enough solutions."""
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
    """Draw n seeds: the start and keyframes (in round 0), then around the start with growing spread, then uniform."""
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

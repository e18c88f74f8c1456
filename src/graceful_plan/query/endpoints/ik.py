"""Inverse kinematics: configurations that bring the tool to a pose.

The core iterates from many seeds at once by damped least squares (`Kernels.reach`), as exactly as doubles allow. If no
seed converges, for instance because of joint limits, a last round has more seeds and more iterations. Solutions that
collide are discarded; the others are sorted by the motion cost of a straight move from the start. A redundant robot
reaches a pose in many ways, and a pose with wide tolerances is a set: the best solutions therefore move towards the
start, and back to the pose, as long as that is cheaper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.query.endpoints.configurations import nearest_turns
from graceful_plan.query.endpoints.pose_solver import PoseSolver
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

FreeTest = Callable[[Array], Array]
"""Returns which of the configurations [n, nq] are free: bool [n]."""

_LAST_SEEDS, _LAST_ITERATIONS = 256, 150
"""Seeds and iterations of the last round, about 5 ms. Of 600 poses of a Panda with up to three joints at limits, the
rounds before failed for one, which this round reached."""
_SAME = 0.1
"""Solutions that differ less than this in every joint [rad or m] count as one."""
_PULLS, _PULL = 12, 0.5
"""Number of moves of a solution towards the start, and share of the way of the first one."""
_PULL_ITERATIONS = 12
"""Largest number of iterations back to the pose after each of them."""
_GAIN = 1e-3
"""Least relative decrease of the cost with which such moves go on."""


@dataclass(frozen=True, eq=False)
class IKResult:
    """Result of inverse kinematics.

    | field             | meaning                                                 | unit     | shape       |
    |-------------------|---------------------------------------------------------|----------|-------------|
    | q                 | solutions, the cheapest move first, possibly none       | rad or m | solution nq |
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
    travel: Travel | None = None,
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
        start: First seed; solutions that are cheap to move to from it come first.
        travel: Cost of moves from the start; by default their length.
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
    moves = Travel(q_start) if travel is None else travel
    solver = PoseSolver(goal, scene, cancelled, moves.ease)
    rng = np.random.default_rng(seed)
    solutions = _Solutions(moves, count, free, cancelled)
    best = (np.inf, np.inf)
    for number in range(rounds):
        if solutions.enough or cancelled():
            break
        found, ended = solver.search(draw_seeds(scene, q_start, seeds, rng, number), iterations)
        best = min(best, solver.errors(ended[0]), key=solver.badness)
        found = nearest_turns(found, q_start, scene)
        cheapest = found[np.argsort(moves.cost(found), kind="stable")[:count]]
        solutions.add(np.concatenate([_nearer(cheapest, solver, moves), found]))
    if not solutions.looked_at and not cancelled():
        found, _ = solver.search(draw_seeds(scene, q_start, seeds, rng, 0), iterations, loose=True)
        solutions.add(nearest_turns(found, q_start, scene))
    if not solutions.looked_at and not cancelled():
        found, ended = solver.search(draw_seeds(scene, q_start, _LAST_SEEDS, rng, rounds), _LAST_ITERATIONS)
        best = min(best, solver.errors(ended[0]), key=solver.badness)
        solutions.add(nearest_turns(found, q_start, scene))
    return IKResult(solutions.nearest_first[:count], *best, solutions.colliding)


@final
class _Solutions:
    """Distinct usable configurations at the pose.

    Args:
        travel: Cost of moves from the start.
        count: Number of solutions that is enough.
        free: Test for free configurations; all are accepted if None.
        cancelled: Polled before each batch.
    """

    def __init__(self, travel: Travel, count: int, free: FreeTest | None, cancelled: Callable[[], bool]) -> None:
        self._travel, self._count, self._free, self._cancelled = travel, count, free, cancelled
        self._q = np.empty((0, len(travel.start)))
        self.looked_at = self.colliding = 0

    @property
    def enough(self) -> bool:
        """Whether there are `count` solutions."""
        return len(self._q) >= self._count

    @property
    def nearest_first(self) -> Float[Array, "n nq"]:
        """All solutions, the cheapest move first."""
        return self._sorted(self._q)

    def add(self, q: Float[Array, "n nq"]) -> None:
        """Check configurations at the pose, the cheapest move first, until there are enough solutions."""
        left = self._sorted(q)
        while len(left) and not self.enough and not self._cancelled():
            some, left = left[: self._count], left[self._count :]
            good = np.ones(len(some), dtype=bool) if self._free is None else np.asarray(self._free(some), dtype=bool)
            self.looked_at += len(some)
            self.colliding += int((~good).sum())
            self._q = _distinct(np.concatenate([self._q, some[good]]))

    def _sorted(self, q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        return q[np.argsort(self._travel.cost(q), kind="stable")]


def _nearer(q: Float[Array, "n nq"], solver: PoseSolver, travel: Travel) -> Float[Array, "m nq"]:
    """Return those solutions that can get nearer to the start while they stay at the pose, as near as that helps."""
    if not len(q):
        return q
    best, cost, pull = q.copy(), travel.cost(q), np.full(len(q), _PULL)
    begun = cost.copy()
    for _ in range(_PULLS):
        tried, reached, _ = solver.reached(best + pull[:, None] * (travel.start - best), _PULL_ITERATIONS)
        price = travel.cost(tried)
        better = reached & (price < (1.0 - _GAIN) * cost)
        best[better], cost[better] = tried[better], price[better]
        pull[~better] *= 0.5
    return best[cost < begun]


def draw_seeds(
    scene: Scene, start: Float[Array, " nq"], n: int, rng: np.random.Generator, number: int
) -> Float[Array, "n nq"]:
    """Draw n seeds: the start and keyframes (in round 0), then around the start with growing spread, then uniform."""
    lower, upper = scene.limits.position.T
    near = start + rng.normal(size=(n // 2, len(start))) * np.linspace(0.1, 1.0, n // 2)[:, None]
    # All directions of a hinge are within half a turn of the start, unless a limit is nearer.
    wide = scene.hinges & (upper - lower > 2.0 * np.pi)
    middle = np.clip(start, lower + np.pi, np.maximum(upper - np.pi, lower + np.pi))
    first, last = np.where(wide, middle - np.pi, lower), np.where(wide, middle + np.pi, upper)
    anywhere = rng.uniform(first, last, size=(n, len(start)))
    known = [start, *scene.keyframes.values()] if number == 0 else []
    return np.clip(np.array([*known, *near, *anywhere])[:n], lower, upper)


def _distinct(q: Float[Array, "n nq"]) -> Float[Array, "m nq"]:
    kept = q[:0]
    for configuration in q:
        if (np.abs(kept - configuration).max(axis=1) > _SAME).all():
            kept = np.concatenate([kept, configuration[None]])
    return kept

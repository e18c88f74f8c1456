"""Inverse kinematics: configurations that bring the tool to a pose.

The core takes many seeds to the pose at once by damped least squares (`Kernels.reach`), as exactly as doubles allow.
Where no seed arrives, for instance because limits are in the way, mink's quadratic programs, which know the limits,
try those that ended nearest. Solutions are filtered by a test for collisions, and come sorted by their distance from
the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

Array = np.ndarray
FreeTest = Callable[[Array], Array]
"""Which of the configurations [n, nq] are free: bool [n]."""

PRECISION = 1e-3
"""Share of the tolerances that a solution may use up."""
_EXACT = 1e-10
"""Error [m and rad together] below which another iteration of mink would change nothing but the rounding."""
_RETRIED = 4
"""Seeds that mink takes on where none arrived."""
_PATIENCE = 10
"""Iterations in which a seed has to make progress."""
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


@final
class PoseSolver:
    """Two ways to one pose: the core's from many seeds at once, and mink's from where that ended."""

    def __init__(self, goal: PoseGoal, scene: Scene, cancelled: Callable[[], bool] = lambda: False) -> None:
        self.goal, self.scene, self.cancelled = goal, scene, cancelled
        self.kernels = compile_scene(scene).kernels
        self.lower, self.upper = scene.limits.position.T

    def search(
        self, seeds: Float[Array, "n nq"], iterations: int, held: slice = slice(0)
    ) -> tuple[Float[Array, "m nq"], Float[Array, "n nq"]]:
        """Iterate from all seeds; return what reached the pose, and where everything ended, the best first.

        Args:
            seeds: Configurations inside the limits.
            iterations: At most, from each seed.
            held: Joints that stay.
        """
        X_WG = np.broadcast_to(self.goal.X_WT, (len(seeds), 4, 4))
        free_yaw = np.full(len(seeds), self.goal.free_yaw)
        q, missing = self.kernels.reach(seeds, X_WG, free_yaw, iterations=iterations, patience=_PATIENCE, held=held)
        exact = within(missing, PRECISION * self.goal.position_tolerance, PRECISION * self.goal.orientation_tolerance)
        return q[exact], q[np.argsort(np.linalg.norm(missing, axis=1), kind="stable")]

    def polish(self, q: Float[Array, "n nq"], iterations: int) -> tuple[Float[Array, "m nq"], Float[Array, "n nq"]]:
        """Move configurations to the pose by mink; return what reached it, and where all of them ended, the best first.

        None ends farther from the pose than it was.
        """
        ended = q.copy()
        errors = np.array([self.errors(configuration) for configuration in q])
        for i, configuration in enumerate(q):
            for _ in range(iterations):
                if self.cancelled():
                    break
                configuration = self._mink_step(configuration)
                error = self.errors(configuration)
                if sum(error) < errors[i].sum() - _EXACT:
                    ended[i], errors[i] = configuration, error
                if sum(error) <= _EXACT:
                    break
        tolerance = (self.goal.position_tolerance, self.goal.orientation_tolerance)
        exact = (errors <= PRECISION * np.array(tolerance)).all(axis=1)
        return ended[exact], ended[np.argsort(errors.sum(axis=1), kind="stable")]

    @cached_property
    def _mink_step(self) -> Callable[[Float[Array, " nq"]], Float[Array, " nq"]]:
        """One iteration of mink, as a function; nothing but the planned joints moves the tool."""
        import mink

        task = mink.FrameTask(
            self.scene.tool,
            "site",
            position_cost=1.0,
            orientation_cost=[1.0, 1.0, 0.0 if self.goal.free_yaw else 1.0],
            lm_damping=1e-3,
        )
        task.set_target(mink.SE3.from_matrix(self.goal.X_WT))
        adr = self.scene.qpos_adr
        limit = mink.ConfigurationLimit(self.scene.model, gain=1.0)
        limit.lower[adr], limit.upper[adr] = self.lower, self.upper
        qpos = self.scene.home_qpos.copy()
        configuration = mink.Configuration(self.scene.model, qpos)

        def step(q: Float[Array, " nq"]) -> Float[Array, " nq"]:
            qpos[adr] = q
            configuration.update(qpos)
            velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", damping=1e-9, limits=[limit])
            return np.clip(configuration.integrate(velocity, 1.0)[adr], self.lower, self.upper)

        return step

    def errors(self, q: Float[Array, " nq"]) -> tuple[float, float]:
        """Position and orientation error of a configuration [m, rad]."""
        return pose_error(self.goal, self.kernels.tool_pose(q))

    def badness(self, error: tuple[float, float]) -> float:
        """Put position and orientation errors on one scale."""
        return error[0] / self.goal.position_tolerance + error[1] / self.goal.orientation_tolerance


def within(
    error: Float[Array, "n 6"], distance: float | Float[Array, " n"], angle: float | Float[Array, " n"]
) -> Bool[Array, " n"]:
    """Tell which errors of poses are no more than a distance [m] and an angle [rad]."""
    return (np.linalg.norm(error[:, :3], axis=1) <= distance) & (np.linalg.norm(error[:, 3:], axis=1) <= angle)

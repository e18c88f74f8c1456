"""Inverse kinematics: configurations that bring the tool to a pose.

Two of them do it. Damped least squares from many seeds at once, on MuJoCo's Jacobians, search: they bring a seed to
within a millimetre or so of the pose, or give it up. mink's differential inverse kinematics finishes: its quadratic
programs, which know the joint limits, take each of those to the exact pose. Where the search brings nothing near, for
instance because limits are in the way, mink tries the best seeds from where they ended. Solutions are filtered by a
test for collisions, and come sorted by their distance from the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.core.tool_motion import damped_step, matrix_vector, rotation_vector
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

Array = np.ndarray
FreeTest = Callable[[Array], Array]
"""Which of the configurations [n, nq] are free: bool [n]."""

PRECISION = 1e-3
"""Share of the tolerances that a solution may use up."""
_NEAR = (1e-3, 1e-2)
"""Distance [m] and angle [rad] from the pose at which the search is done and mink takes over."""
_POLISHING = 8
"""Iterations of mink from there at most; Newton's method needs three where no limit is in the way."""
_EXACT = 1e-10
"""Error [m and rad together] below which another iteration would change nothing but the rounding."""
_LARGEST_STEP = 0.5
"""Of a joint in one iteration of the search [rad or m]."""
_RETRIED = 4
"""How many of the best seeds mink takes on where the search brought none near."""
_PATIENCE, _PROGRESS = 10, 0.7
"""A seed is given up if the error is not below this share of what it was that many iterations before."""
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
    reached = np.empty((0, len(q_start)))
    colliding, best = 0, (np.inf, np.inf)
    for number in range(rounds):
        near, ended = solver.search(draw_seeds(scene, q_start, seeds, rng, number), iterations)
        best = min(best, solver.errors(ended[0]), key=solver.badness)
        near = near[np.argsort(np.linalg.norm(near - q_start, axis=1), kind="stable")]
        left, longest = (near, _POLISHING) if len(near) else (ended[:_RETRIED], iterations // 2)
        out_of_reach = True
        # The nearest first, and no more of them than it takes: most of the time goes into mink.
        while len(left) and len(reached) < count and not cancelled():
            found, ended = solver.polish(left[:count], longest)
            left, out_of_reach = left[count:], out_of_reach and not len(found)
            best = min(best, solver.errors(ended[0]), key=solver.badness)
            good = np.ones(len(found), dtype=bool) if free is None else np.asarray(free(found), dtype=bool)
            colliding += int((~good).sum())
            reached = _distinct(np.concatenate([reached, found[good]]))
        if out_of_reach or len(reached) >= count or cancelled():
            break
    order = np.argsort(np.linalg.norm(reached - q_start, axis=1), kind="stable")
    return IKResult(reached[order][:count], *best, colliding)


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
    kept: list[Array] = []
    for configuration in q:
        if all(np.abs(configuration - other).max() > _SAME for other in kept):
            kept.append(configuration)
    return np.array(kept).reshape(-1, q.shape[1])


@final
class PoseSolver:
    """The two kinds of iterations towards one pose: a search from seeds, and mink's from where that ended."""

    def __init__(self, goal: PoseGoal, scene: Scene, cancelled: Callable[[], bool] = lambda: False) -> None:
        self.goal, self.scene, self.placement, self.cancelled = goal, scene, Placement(scene), cancelled
        self.model = scene.model
        self.site = self.model.site(scene.tool).id
        self.dofs = self.model.jnt_dofadr[[self.model.joint(name).id for name in scene.joints]]
        self.lower, self.upper = scene.limits.position.T

    def search(self, seeds: Float[Array, "n nq"], iterations: int) -> tuple[Float[Array, "m nq"], Float[Array, "n nq"]]:
        """Iterate from all seeds; return what came near the pose, and where everything ended, the best first."""
        q = seeds.copy()
        active = np.arange(len(q))
        past = np.full(len(q), np.inf)
        for iteration in range(iterations):
            error, jacobian = self._linearised(q[active])
            going = ~within(error, *_NEAR)
            if iteration % _PATIENCE == _PATIENCE - 1:
                size = np.linalg.norm(error, axis=1)
                going &= size < _PROGRESS * past[active]
                past[active] = size
            active, error, jacobian = _select(going, active, error, jacobian)
            if not len(active) or self.cancelled():
                break
            q[active] = stepped(q[active], error, jacobian, (self.lower, self.upper))
        error, _ = self._linearised(q)
        return q[within(error, *_NEAR)], q[_best_first(error)]

    def settled(
        self, seeds: Float[Array, "n nq"], iterations: int, held: slice
    ) -> tuple[Float[Array, "m nq"], tuple[float, float]]:
        """Iterate from seeds near the pose until it is exact, some joints held; return what reached it, and errors.

        Where no limit is in the way this is Newton's method, and mink has nothing to add.
        """
        q = seeds.copy()
        error, jacobian = self._linearised(q)
        for _ in range(iterations):
            going = ~self._exact(error)
            if not going.any() or self.cancelled():
                break
            jacobian[:, :, held] = 0.0
            q[going] = np.clip(q[going] + _short_step(error[going], jacobian[going]), self.lower, self.upper)
            error, jacobian = self._linearised(q)
        best = q[_best_first(error)[0]]
        return q[self._exact(error)], self.errors(best)

    def _exact(self, error: Float[Array, "n 6"]) -> Bool[Array, " n"]:
        goal = self.goal
        return within(error, PRECISION * goal.position_tolerance, PRECISION * goal.orientation_tolerance)

    def polish(self, q: Float[Array, "n nq"], iterations: int) -> tuple[Float[Array, "m nq"], Float[Array, "n nq"]]:
        """Move configurations to the pose by mink; return what reached it, and where all of them ended, the best first.

        None ends farther from the pose than it was.
        """
        ended = q.copy()
        for i, configuration in enumerate(q):
            least = sum(self.errors(configuration))
            for _ in range(iterations):
                if self.cancelled():
                    break
                configuration = self._mink_step(configuration)
                error = sum(self.errors(configuration))
                if error < least - _EXACT:
                    ended[i], least = configuration, error
                if error <= _EXACT:
                    break
        error, _ = self._linearised(ended)
        return ended[self._exact(error)], ended[_best_first(error)]

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
        limit = mink.ConfigurationLimit(self.model, gain=1.0)
        limit.lower[adr], limit.upper[adr] = self.lower, self.upper
        qpos = self.scene.home_qpos.copy()
        configuration = mink.Configuration(self.model, qpos)

        def step(q: Float[Array, " nq"]) -> Float[Array, " nq"]:
            qpos[adr] = q
            configuration.update(qpos)
            velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", damping=1e-9, limits=[limit])
            return np.clip(configuration.integrate(velocity, 1.0)[adr], self.lower, self.upper)

        return step

    def errors(self, q: Float[Array, " nq"]) -> tuple[float, float]:
        """Position and orientation error of a configuration [m, rad]."""
        return pose_error(self.goal, self._pose(q))

    def badness(self, error: tuple[float, float]) -> float:
        """Put position and orientation errors on one scale."""
        return error[0] / self.goal.position_tolerance + error[1] / self.goal.orientation_tolerance

    def _pose(self, q: Float[Array, " nq"]) -> Float[Array, "4 4"]:
        data = self.placement.place(q)
        X_WT = np.eye(4)
        X_WT[:3, :3] = data.site_xmat[self.site].reshape(3, 3)
        X_WT[:3, 3] = data.site_xpos[self.site]
        return X_WT

    def _linearised(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, "n 6"], Float[Array, "n 6 nq"]]:
        """Return what is missing to the pose, as translation [m] and rotation vector in W [rad], and its Jacobian."""
        error, jacobian = np.empty((len(q), 6)), np.empty((len(q), 6, q.shape[1]))
        full = np.empty((6, self.model.nv))
        R, goal = np.empty((len(q), 3, 3)), self.goal.X_WT
        for i, configuration in enumerate(q):
            data = self.placement.place(configuration)
            mujoco.mj_comPos(self.model, data)
            mujoco.mj_jacSite(self.model, data, full[:3], full[3:], self.site)
            jacobian[i] = full[:, self.dofs]
            R[i] = data.site_xmat[self.site].reshape(3, 3)
            error[i, :3] = goal[:3, 3] - data.site_xpos[self.site]
        if self.goal.free_yaw:
            z = R[:, :, 2]
            error[:, 3:] = rotation_vector(np.cross(z, goal[:3, 2]), z @ goal[:3, 2])
            jacobian[:, 3:] -= z[:, :, None] * np.einsum("ni,nij->nj", z, jacobian[:, 3:])[:, None]
        else:
            error[:, 3:] = matrix_vector(goal[:3, :3] @ R.transpose(0, 2, 1))
        return error, jacobian


def within(
    error: Float[Array, "n 6"], distance: float | Float[Array, " n"], angle: float | Float[Array, " n"]
) -> Bool[Array, " n"]:
    """Tell which errors of poses are no more than a distance [m] and an angle [rad]."""
    return (np.linalg.norm(error[:, :3], axis=1) <= distance) & (np.linalg.norm(error[:, 3:], axis=1) <= angle)


def _best_first(error: Float[Array, "n 6"]) -> Int[Array, " n"]:
    return np.argsort(np.linalg.norm(error, axis=1), kind="stable")


def stepped(
    q: Float[Array, "n nq"],
    error: Float[Array, "n 6"],
    jacobian: Float[Array, "n 6 nq"],
    limits: tuple[Float[Array, " nq"], Float[Array, " nq"]],
) -> Float[Array, "n nq"]:
    """Step towards poses; joints that would leave their limits stay, and the others make up for them."""
    lower, upper = limits
    step = _short_step(error, jacobian)
    blocked = ((q + step < lower) & (step < 0.0)) | ((q + step > upper) & (step > 0.0))
    held = blocked.any(axis=1)
    if held.any():
        step[held] = _short_step(error[held], np.where(blocked[held, None, :], 0.0, jacobian[held]))
    return np.clip(q + step, lower, upper)


def _short_step(error: Float[Array, "n 6"], jacobian: Float[Array, "n 6 nq"]) -> Float[Array, "n nq"]:
    step = damped_step(error, jacobian)
    return step * np.minimum(1.0, _LARGEST_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))


def _select(mask: Bool[Array, " n"], *arrays: Array) -> tuple[Array, ...]:
    return tuple(array[mask] for array in arrays)

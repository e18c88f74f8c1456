"""Inverse kinematics: configurations that bring the tool to a pose.

Damped least squares from many seeds at once on MuJoCo's Jacobians; what it cannot finish, for instance because joint
limits are in the way, mink's quadratic programs retry from the best seeds. Solutions are filtered by a test for
collisions, and come sorted by their distance from the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

Array = np.ndarray
FreeTest = Callable[[Array], Array]
"""Which of the configurations [n, nq] are free: bool [n]."""

_PRECISION = 1e-3
"""Share of the tolerances that a solution may use up."""
_LARGEST_STEP = 0.5
"""Of a joint in one iteration [rad or m]."""
_POLISHED = 4
"""How many of the best seeds mink tries again where nothing was reached."""
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
    solver = _Solver(goal, scene, cancelled)
    rng = np.random.default_rng(seed)
    reached = np.empty((0, len(q_start)))
    colliding, best = 0, (np.inf, np.inf)
    for number in range(rounds):
        found, best_here = solver.descend(_seeds(scene, q_start, seeds, rng, number), iterations)
        if not len(found):
            found, best_here = solver.polish(best_here[:_POLISHED], iterations // 2)
        best = min(best, solver.errors(best_here), key=solver.badness)
        if not len(found):
            break  # not one of so many seeds: out of reach
        good = np.ones(len(found), dtype=bool) if free is None else np.asarray(free(found), dtype=bool)
        colliding += int((~good).sum())
        nearest = np.argsort(np.linalg.norm(found[good] - q_start, axis=1), kind="stable")
        reached = _distinct(np.concatenate([reached, found[good][nearest]]))
        if len(reached) >= count or cancelled():
            break
    order = np.argsort(np.linalg.norm(reached - q_start, axis=1), kind="stable")
    return IKResult(reached[order][:count], *best, colliding)


def _seeds(
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


class _Solver:
    """Iterations towards one pose."""

    def __init__(self, goal: PoseGoal, scene: Scene, cancelled: Callable[[], bool] = lambda: False) -> None:
        self.goal, self.scene, self.placement, self.cancelled = goal, scene, Placement(scene), cancelled
        self.model = scene.model
        self.site = self.model.site(scene.tool).id
        self.dofs = self.model.jnt_dofadr[[self.model.joint(name).id for name in scene.joints]]
        self.lower, self.upper = scene.limits.position.T

    def descend(
        self, seeds: Float[Array, "n nq"], iterations: int
    ) -> tuple[Float[Array, "m nq"], Float[Array, "n nq"]]:
        """Iterate from all seeds; return what reached the pose, and where everything ended, the best first."""
        q = seeds.copy()
        active = np.arange(len(q))
        past = np.full(len(q), np.inf)
        for iteration in range(iterations):
            error, jacobian = self._linearised(q[active])
            going = ~self._done(error)
            if iteration % _PATIENCE == _PATIENCE - 1:
                size = np.linalg.norm(error, axis=1)
                going &= size < _PROGRESS * past[active]
                past[active] = size
            active, error, jacobian = _select(going, active, error, jacobian)
            if not len(active) or self.cancelled():
                break
            step = _damped_step(error, jacobian)
            blocked = ((q[active] + step < self.lower) & (step < 0.0)) | (
                (q[active] + step > self.upper) & (step > 0.0)
            )
            # Joints that would leave their limits stay; the others make up for them.
            again = _damped_step(error, np.where(blocked[:, None, :], 0.0, jacobian))
            q[active] = np.clip(q[active] + again, self.lower, self.upper)
        error, _ = self._linearised(q)
        order = np.argsort(np.linalg.norm(error, axis=1), kind="stable")
        return q[self._done(error)], q[order]

    def polish(self, q: Float[Array, "n nq"], iterations: int) -> tuple[Float[Array, "m nq"], Float[Array, "n nq"]]:
        """Do what `descend` does by mink, whose quadratic programs know the joint limits."""
        import mink

        task = mink.FrameTask(
            self.scene.tool,
            "site",
            position_cost=1.0,
            orientation_cost=[1.0, 1.0, 0.0 if self.goal.free_yaw else 1.0],
            lm_damping=1e-3,
        )
        task.set_target(mink.SE3.from_matrix(self.goal.X_WT))
        others = np.setdiff1d(np.arange(self.model.nv), self.dofs)
        frozen = [mink.DofFreezingTask(self.model, dof_indices=others.tolist())] if len(others) else []
        limits = [mink.ConfigurationLimit(self.model)]
        ended = q.copy()
        for i, seed in enumerate(q):
            configuration = mink.Configuration(self.model, self.placement.place(seed).qpos.copy())
            for _ in range(iterations):
                velocity = mink.solve_ik(
                    configuration, [task], 1.0, "daqp", damping=1e-6, limits=limits, constraints=frozen
                )
                configuration.integrate_inplace(velocity, 1.0)
                ended[i] = np.clip(configuration.q[self.scene.qpos_adr], self.lower, self.upper)
                if self._done(self._linearised(ended[i : i + 1])[0])[0] or self.cancelled():
                    break
        error, _ = self._linearised(ended)
        order = np.argsort(np.linalg.norm(error, axis=1), kind="stable")
        return ended[self._done(error)], ended[order]

    def errors(self, q: Float[Array, "n nq"]) -> tuple[float, float]:
        """Position and orientation error of the first configuration."""
        return pose_error(self.goal, self._pose(q[0]))

    def badness(self, error: tuple[float, float]) -> float:
        """Put position and orientation errors on one scale."""
        return error[0] / self.goal.position_tolerance + error[1] / self.goal.orientation_tolerance

    def _done(self, error: Float[Array, "n 6"]) -> Bool[Array, " n"]:
        near = np.linalg.norm(error[:, :3], axis=1) <= _PRECISION * self.goal.position_tolerance
        return near & (np.linalg.norm(error[:, 3:], axis=1) <= _PRECISION * self.goal.orientation_tolerance)

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
            error[:, 3:] = _turn(np.cross(z, goal[:3, 2]), z @ goal[:3, 2], np.array([1.0, 0.0, 0.0]))
            jacobian[:, 3:] -= z[:, :, None] * np.einsum("ni,nij->nj", z, jacobian[:, 3:])[:, None]
        else:
            D = goal[:3, :3] @ R.transpose(0, 2, 1)
            skew = 0.5 * np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1)
            error[:, 3:] = _turn(skew, 0.5 * (np.trace(D, axis1=1, axis2=2) - 1.0), np.array([1.0, 0.0, 0.0]))
        return error, jacobian


def _damped_step(error: Float[Array, "n 6"], jacobian: Float[Array, "n 6 nq"]) -> Float[Array, "n nq"]:
    """Least-squares steps; damping fades with the error: steady far away, as fast as Newton's method close by."""
    damping = 1e-2 * (error**2).sum(axis=1) + 1e-9
    gram = jacobian @ jacobian.transpose(0, 2, 1) + damping[:, None, None] * np.eye(6)
    step = np.einsum("nij,ni->nj", jacobian, np.linalg.solve(gram, error[..., None])[..., 0])
    return step * np.minimum(1.0, _LARGEST_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))


def _turn(sine: Float[Array, "n 3"], cosine: Float[Array, " n"], fallback: Float[Array, " 3"]) -> Float[Array, "n 3"]:
    """Return rotation vectors from sin(angle) * axis and cos(angle); any axis if the angle is pi."""
    length = np.linalg.norm(sine, axis=1, keepdims=True)
    angle = np.arctan2(length[:, 0], cosine)[:, None]
    axis = np.where(length > 1e-9, sine / np.maximum(length, 1e-9), np.where(angle > 1.0, fallback, 0.0))
    return angle * axis


def _select(mask: Bool[Array, " n"], *arrays: Array) -> tuple[Array, ...]:
    return tuple(array[mask] for array in arrays)

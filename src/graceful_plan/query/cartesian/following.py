"""Configurations along a straight motion of the tool, by differential inverse kinematics of several candidates at once.

A redundant arm may follow the line in many ways. Each candidate has an attractor, a configuration towards which its
joints drift in the null space of the line. The first candidate has none and moves its joints as little as possible; the
attractors of the others are random.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core.kernels import Kernels
from graceful_plan.core.tool_motion import missing_twist, steps_inside, tool_jacobian, without_yaw
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

_STEP = (0.01, np.deg2rad(2.0))
"""Largest step of the tool along the line [m, rad]."""
_FEWEST = 8
"""Least number of steps."""
_MOST = 2000
"""Largest number of steps before refinement: 20 m, beyond the reach of any arm."""
_EXACT = 1e-8
"""Largest remaining error of a pose after a step [m and rad]."""
_ITERATIONS = 6
"""Newton iterations for a step; three are enough away from limits."""
_JUMP = 0.25
"""Largest step of a joint for a step of the tool [rad or m]: 25 rad per metre, more than an arm needs except near a
singularity."""
_RESERVE = 1e-4
"""Distance that joints keep from their limits [rad or m], so that a curve between two steps does not exceed them."""
_PULLS = (0.3, 1.0, 3.0)
"""Gains of the drift towards the attractors: over a line, the distance decays by the exponential of the gain."""


@runtime_checkable
class ToolPath(Protocol):
    """A path of the tool, such as a `ToolLine`."""

    @property
    def goal(self) -> PoseGoal:
        """Pose at the end; with free yaw only the tool's z axis counts all along."""
        ...

    @property
    def length(self) -> float:
        """Distance that the tool's origin travels [m]."""
        ...

    @property
    def angle(self) -> float:
        """Angle of the tool's rotation [rad]."""
        ...

    def poses(self, share: Float[Array, " n"]) -> Float[Array, "n 4 4"]:
        """Return the pose of the tool in W at shares of the path, 0 to 1."""
        ...


PathT = TypeVar("PathT", bound=ToolPath)


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """Candidates that follow a line.

    | field  | meaning                                                       | unit     | shape              |
    |--------|---------------------------------------------------------------|----------|--------------------|
    | q      | configurations, evenly spaced along the line up to `share`    | rad or m | candidate point nq |
    | share  | fraction of the line that the farthest candidate has followed |          |                    |
    | why    | reason why no candidate could go on; empty at the end         |          |                    |
    """

    q: Float[Array, "candidate point nq"]
    share: float
    why: str


@dataclass(frozen=True, eq=False)
class Follower(Generic[PathT]):
    """Follows one line, or another path of the tool, with an arm.

    Args:
        scene: Scene with robot and limits.
        kernels: Kernels of the scene.
        line: Path of the tool.
        start: Configuration at the start of the path.
    """

    scene: Scene
    kernels: Kernels
    line: PathT
    start: Float[Array, " nq"]

    @property
    def limits(self) -> tuple[Float[Array, " nq"], Float[Array, " nq"]]:
        """Lower and upper joint limits, tightened by `_RESERVE` except where the start is closer to a limit."""
        lower, upper = self.scene.limits.position.T
        return np.minimum(lower + _RESERVE, self.start), np.maximum(upper - _RESERVE, self.start)

    def _wishes(self, n: int, rng: np.random.Generator) -> tuple[Float[Array, "n nq"], Float[Array, " n"]]:
        """Return attractors and gains: none for the first candidate, the middle of the limits, then random ones."""
        wishes, pulls = self._drawn(n, rng)
        pulls[0] = 0.0
        wishes[1:2], pulls[1:2] = 0.5 * sum(self.limits), 1.0
        return wishes, pulls

    def _drawn(self, n: int, rng: np.random.Generator) -> tuple[Float[Array, "n nq"], Float[Array, " n"]]:
        return rng.uniform(*self.limits, size=(n, len(self.start))), rng.choice(_PULLS, n)

    def follow(self, n: int, rng: np.random.Generator, finer: int = 1) -> Followed:
        """Follow the line step by step with n candidates.

        A candidate is replaced by a copy of another one with a new attractor if it cannot go on, or if it collides by
        the fast checker while another candidate does not. This resampling lets few candidates find postures that are
        needed only later on the line.

        Args:
            n: Number of candidates.
            rng: Random numbers for attractors.
            finer: Number of parts to divide each step into.
        """
        steps = finer * self._steps()
        q = np.repeat(np.repeat(self.start[None, None], steps + 1, axis=1), n, axis=0)
        wishes, pulls = self._wishes(n, rng)
        poses = self.line.poses(np.arange(steps + 1) / steps)
        clear = bool(self.kernels.free(self.start))
        for k in range(1, steps + 1):
            before = q[:, k - 1]
            drift = (pulls / steps)[:, None] * (wishes - before)
            after, held, exact = self._to_pose(before, np.tile(poses[k], (n, 1, 1)), drift)
            leaps = np.abs(after - before).max(axis=1, initial=0.0) > _JUMP
            kept = exact & ~leaps
            if not kept.any():
                return Followed(q=q[:, :k], share=(k - 1) / steps, why=self._reason(held, leaps=leaps & exact))
            q[:, k] = after
            free = self.kernels.free(after) & kept
            kept = free if clear and free.any() else kept
            lost = np.flatnonzero(~kept)
            if len(lost):
                q[lost, : k + 1] = q[rng.choice(np.flatnonzero(kept), len(lost)), : k + 1]
                wishes[lost], pulls[lost] = self._drawn(len(lost), rng)
        return Followed(q=q, share=1.0, why="")

    def onto_line(self, q: Float[Array, "n nq"], share: Float[Array, " n"]) -> Float[Array, "n nq"] | None:
        """Move configurations near the line onto it, at these shares; return None if that fails for any."""
        moved, _, exact = self._to_pose(q, self.line.poses(share), np.zeros_like(q))
        return moved if exact.all() and np.abs(moved - q).max(initial=0.0) <= _JUMP else None

    def _steps(self) -> int:
        longest = max(self.line.length / _STEP[0], self.line.angle / _STEP[1])
        return int(np.clip(np.ceil(longest), _FEWEST, _MOST))

    def _to_pose(
        self, q: Float[Array, "n nq"], goal: Float[Array, "n 4 4"], drift: Float[Array, "n nq"]
    ) -> tuple[Float[Array, "n nq"], Bool[Array, "n nq"], Bool[Array, " n"]]:
        """Move configurations to poses.

        Returns:
            Configurations, joints held by their limits in the first iteration, and whether each pose is reached.
        """
        free_yaw, held = self.line.goal.free_yaw, np.zeros(q.shape, dtype=bool)
        exact = np.zeros(len(q), dtype=bool)
        for iteration in range(_ITERATIONS + 1):
            X_WT, jacobian = tool_jacobian(self.kernels, q)
            missing = missing_twist(X_WT, goal, free_yaw=free_yaw)
            exact = np.abs(missing).max(axis=1, initial=0.0) <= _EXACT
            if iteration == _ITERATIONS or (iteration and exact.all()):
                break
            if free_yaw:
                jacobian = without_yaw(X_WT, jacobian)
            step, holding = steps_inside(missing, jacobian, q, self.limits, drift if iteration == 0 else 0.0)
            held = holding if iteration == 0 else held
            # Steps beyond `_JUMP` are discarded anyway; clipped, they stay in the range that kernels accept.
            q = q + np.clip(step, -2.0 * _JUMP, 2.0 * _JUMP)
        return q, held, exact

    def _reason(self, held: Bool[Array, "n nq"], *, leaps: Bool[Array, " n"]) -> str:
        """Return why no candidate can go on: limits, of the candidate with the fewest held joints, or a singularity."""
        stuck = held[held.any(axis=1)]
        if len(stuck) == len(held):
            names = [
                repr(name)
                for name, is_held in zip(self.scene.joints, stuck[np.argmin(stuck.sum(axis=1))], strict=True)
                if is_held
            ]
            return f"held by the limit of joint {' and '.join(names)}"
        if leaps.any():
            return "singular: its joints would have to jump"
        return "stretched out or singular: no joint step moves the tool along the line"

"""Configurations along a straight motion of the tool: differential inverse kinematics, several arms' ways at once.

An arm with more joints than the line asks for may follow it in many ways. Each candidate has a wish, a configuration
towards which its joints drift as far as the line leaves them free to: the first has none and moves its joints as
little as it can, the others spread out over what is possible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.kernels import Kernels
from graceful_plan.core.tool_motion import missing_twist, steps_inside, tool_jacobian, without_yaw
from graceful_plan.query.cartesian.line import ToolLine
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_STEP = (0.01, np.deg2rad(2.0))
"""Largest step of the tool along the line [m, rad]."""
_FEWEST = 8
"""Steps at least."""
_MOST = 2000
"""Steps at most, before they are made finer: 20 m, beyond any arm."""
_EXACT = 1e-8
"""What may be missing to a pose after a step [m and rad]."""
_ITERATIONS = 6
"""Of Newton's method for a step; three do where nothing is in the way."""
_JUMP = 0.25
"""Largest step of a joint for a step of the tool [rad or m]: 25 rad for a metre, beyond any arm in reach of a pose."""
_RESERVE = 1e-4
"""Distance that joints keep from their limits [rad or m], so that a curve between two steps does not exceed them."""
_PULLS = (0.3, 1.0, 3.0)
"""How strongly joints drift towards what they wish for; it decays by the exponential of that over a line."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """How candidates follow a line.

    | field  | meaning                                                     | unit     | shape              |
    |--------|-------------------------------------------------------------|----------|--------------------|
    | q      | configurations at even shares of the line, as far as any went | rad or m | candidate point nq |
    | share  | how far along the line that is                              |          |                    |
    | why    | what stopped all of them; empty if they went all the way    |          |                    |
    """

    q: Float[Array, "candidate point nq"]
    share: float
    why: str


@dataclass(frozen=True, eq=False)
class Follower:
    """Moves arms along one line.

    Args:
        scene: Robot and limits.
        kernels: Those of the scene.
        line: What the tool is to do.
        start: Configuration that the line begins at.
    """

    scene: Scene
    kernels: Kernels
    line: ToolLine
    start: Float[Array, " nq"]

    @property
    def limits(self) -> tuple[Float[Array, " nq"], Float[Array, " nq"]]:
        """Lower and upper limits to keep, those of the scene less a reserve where the start has it."""
        lower, upper = self.scene.limits.position.T
        return np.minimum(lower + _RESERVE, self.start), np.maximum(upper - _RESERVE, self.start)

    def _wishes(self, n: int, rng: np.random.Generator) -> tuple[Float[Array, "n nq"], Float[Array, " n"]]:
        """Return what candidates wish for, and how strongly: nothing, the middle of the limits, then anything."""
        wishes, pulls = self._drawn(n, rng)
        pulls[0] = 0.0
        wishes[1:2], pulls[1:2] = 0.5 * sum(self.limits), 1.0
        return wishes, pulls

    def _drawn(self, n: int, rng: np.random.Generator) -> tuple[Float[Array, "n nq"], Float[Array, " n"]]:
        return rng.uniform(*self.limits, size=(n, len(self.start))), rng.choice(_PULLS, n)

    def follow(self, n: int, rng: np.random.Generator, finer: int = 1) -> Followed:
        """Go along the line step by step with n candidates.

        One that cannot go on, or collides by the fast checker while another does not, begins anew where another is,
        with another wish: so few candidates find where the arm has to lean early on to get through later.

        Args:
            n: How many.
            rng: Where wishes come from.
            finer: Divides the steps.
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
        """Move configurations that are near to the line onto it, at these shares; None if that fails."""
        moved, _, exact = self._to_pose(q, self.line.poses(share), np.zeros_like(q))
        return moved if exact.all() and np.abs(moved - q).max(initial=0.0) <= _JUMP else None

    def _steps(self) -> int:
        longest = max(self.line.length / _STEP[0], self.line.angle / _STEP[1])
        return int(np.clip(np.ceil(longest), _FEWEST, _MOST))

    def _to_pose(
        self, q: Float[Array, "n nq"], goal: Float[Array, "n 4 4"], drift: Float[Array, "n nq"]
    ) -> tuple[Float[Array, "n nq"], Bool[Array, "n nq"], Bool[Array, " n"]]:
        """Return configurations at poses, which joints their limits held at first, and which of them are exact."""
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
            # A step farther than a jump is refused anyhow, and must not leave the range that kernels take.
            q = q + np.clip(step, -2.0 * _JUMP, 2.0 * _JUMP)
        return q, held, exact

    def _reason(self, held: Bool[Array, "n nq"], *, leaps: Bool[Array, " n"]) -> str:
        """Say what stopped candidates: the limits that held the fewest joints, or that there is no way on."""
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
        return "stretched out or singular: no step of its joints takes the tool on"

"""Gymnasium spaces of observations and actions."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces

from failbench.policies.policy import Observation, PolicyError
from failbench.policies.task import PolicyTask
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.path import real_array

KINDS = ("joint_position", "joint_velocity", "tool_pose")
"""Kinds of actions that environments support."""
_TOOL_SPEED = (0.5, 1.5)
"""Greatest commanded tool speed [m/s] and angular speed [rad/s]."""
_WIDE = 10.0
"""Bound of positions [m]. Readings beyond a bound are clamped."""
_FAST = 10.0
"""Bound of joint speeds, as a multiple of the joints' limits."""
STATE = "state"
"""Key of the observation vector, beside the pictures."""


class Spaces:
    """Action and observation space of a task, and the conversion from and to physical units.

    Args:
        task: The task.
        kind: Kind of the actions.
    """

    def __init__(self, task: PolicyTask, kind: str) -> None:
        if kind not in KINDS:
            raise UnknownNameError("action", kind, KINDS)
        self._task, self._kind = task, kind
        self._targets: dict[int, Float[Array, " 7"]] = {}
        size = 6 if kind == "tool_pose" else len(task.start)
        self.action = spaces.Box(-1.0, 1.0, (size,), np.float32)
        self._low, self._high = task.scene.limits.position.T
        self._speed = task.settings.speed * task.scene.limits.velocity
        fast, wide = _FAST * task.scene.limits.velocity, np.full(14, _WIDE)
        wide[[0, 1, 2, 3, 7, 8, 9, 10]] = 1.01
        places = np.full(3 * len(task.scene.entities), _WIDE)
        span = self._high - self._low
        low = [self._low - span, -fast, -wide[:7], self._low, -wide[7:], -places]
        high = [self._high + span, fast, wide[:7], self._high, wide[7:], places]
        state = spaces.Box(np.concatenate(low).astype(np.float32), np.concatenate(high).astype(np.float32))
        pictures = {name: spaces.Box(0, 255, (*task.settings.size, 3), np.uint8) for name in task.settings.cameras}
        self._state = state
        self.observation: Any = spaces.Dict({STATE: state, **pictures}) if pictures else state

    def observed(self, seen: Observation) -> Any:
        """Return an observation as an element of the observation space."""
        row = np.clip(seen.vector, self._state.low, self._state.high).astype(np.float32)
        return {STATE: row, **seen.images} if self._task.settings.cameras else row

    def begin(self, sim: int, seen: Observation) -> None:
        """Store the initial tool pose of an episode as the target for tool actions."""
        self._targets[sim] = seen.tool

    def meant(self, sim: int, action: Array) -> tuple[str, Float[Array, " n"]]:
        """Return an action's kind and its value in physical units.

        Raises:
            PolicyError: If the action has the wrong shape, or is not finite.
        """
        given = real_array("action", action)
        if given.shape != self.action.shape or not np.isfinite(given).all():
            wanted = f"{self.action.shape} finite numbers"
            raise PolicyError(self._kind, f"returned an action of shape {given.shape}, expected {wanted}")
        given = np.clip(given, -1.0, 1.0)
        if self._kind == "joint_position":
            return self._kind, self._low + 0.5 * (given + 1.0) * (self._high - self._low)
        if self._kind == "joint_velocity":
            return self._kind, self._speed * given
        target, period = self._targets[sim].copy(), self._task.settings.period
        target[4:] += period * _TOOL_SPEED[0] * given[:3]
        turn = np.empty(4)
        angle = float(np.linalg.norm(given[3:]))
        axis = given[3:] / angle if angle > 0.0 else np.array([1.0, 0.0, 0.0])
        mujoco.mju_axisAngle2Quat(turn, axis, period * _TOOL_SPEED[1] * angle)
        mujoco.mju_mulQuat(target[:4], turn, self._targets[sim][:4])
        self._targets[sim] = target
        return self._kind, target

"""Policies from planned motions, a script, trained networks, and LeRobot policies."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import graceful_plan as gp
from failbench.policies.mlp import Mlp
from failbench.policies.policy import Acting, Observation, Policy, PolicyError, PolicyFactory, check_action
from failbench.policies.task import PolicyTask
from failbench.rollouts.execution import Execution
from graceful_plan.array_types import Array, Float

_LIFT = 0.15
"""Height by which the scripted policy lifts the tool before it moves across [m]."""
_PACE = 0.3
"""Speed of the scripted tool motion [m/s]."""
_TURN = 1.0
"""Angular speed of the scripted tool motion [rad/s]."""
_FADE = 0.5
"""Time in which an initial offset from the motion fades out [s], clamped to the motion's duration."""
REACH = FilePath(__file__).parent / "reach.npz"
"""Weights of `reach`, trained by `benchmarks/train_reach.py`."""


class OpenLoop:
    """Policy that follows a trajectory by the clock; the initial offset from the trajectory fades out.

    Args:
        motion: The trajectory.
        period: Time between actions [s].
    """

    action = "joint_position"

    def __init__(self, motion: gp.Trajectory, period: float) -> None:
        self.motion, self._period = motion, period
        self._offset: Float[Array, " nq"] | None = None

    def __call__(self, observation: Observation, /) -> Float[Array, " nq"]:
        """Return the joint positions for the end of the period."""
        return self.at(observation.time, observation.q)

    def at(self, time: float, q: Float[Array, " nq"]) -> Float[Array, " nq"]:
        """Return the joint positions for a period after `time`.

        Args:
            time: Time since the beginning of the motion [s].
            q: Current joint positions; only the first call uses them.
        """
        motion, after = self.motion, time + self._period
        offset = self._offset = q - motion.q[0] if self._offset is None else self._offset
        wanted = motion.at(motion.t[0] + np.array([min(after, motion.duration)])).q[0]
        part = min(1.0, after / min(_FADE, max(motion.duration, self._period)))
        # Minimum jerk, since a step of the target would spill the contents.
        return wanted + (1.0 - part**3 * (10.0 + part * (6.0 * part - 15.0))) * offset


def executor(execution: Execution) -> PolicyFactory:
    """Return a policy that replays an execution's commands; it needs the time step as period, and noise 0."""

    def make(task: PolicyTask, seed: int) -> Policy:
        steps = task.settings.steps

        def act(observation: Observation) -> Float[Array, " actuator"]:
            return execution.commands(round(observation.time / execution.dt), steps)[0]

        return Acting(act, "command")

    return make


def planned(w: float | None = None, *, iterations: int = 500, seed: int = 0, planner: str = "auto") -> PolicyFactory:
    """Return a policy that plans once and follows the motion by the clock.

    Args:
        w: Safety weight; None for the planner's default.
        iterations: Iterations of the planner, instead of a time budget, so that the motion is reproducible.
        seed: Seed of the planner.
        planner: Name of the planner.
    """

    @lru_cache(maxsize=8)
    def motion(task: PolicyTask) -> gp.Trajectory:
        settings = task.settings
        found = gp.plan(
            task.start,
            task.goal,
            task.scene,
            w=w,
            planner=planner,
            iterations=iterations,
            seed=seed,
            speed=settings.speed,
        )
        return found.unwrap()

    def make(task: PolicyTask, seed: int) -> Policy:
        return OpenLoop(motion(task), task.settings.period)

    return make


class Scripted:
    """Policy that lifts the tool, moves it straight across and puts it down, by the measured tool pose."""

    action = "tool_pose"

    def __init__(self, task: PolicyTask) -> None:
        self._period = task.settings.period
        self._stage = 0

    def __call__(self, observation: Observation, /) -> Float[Array, " 7"]:
        """Return the tool pose for the end of the period."""
        tool, goal = observation.tool, observation.tool_goal
        if self._stage == 0:
            self._height = max(tool[6], goal[6]) + _LIFT
        above_goal = np.array([goal[4], goal[5], self._height])
        if self._stage == 0:
            self._via, self._stage = [np.array([tool[4], tool[5], self._height]), above_goal], 1
            self._place, self._quat = tool[4:].copy(), tool[:4].copy()
        target = self._via[0] if self._via else goal[4:]
        self._place = _towards(self._place, target, _PACE * self._period)
        if self._via and float(np.linalg.norm(self._place - target)) < 1e-6:
            self._via.pop(0)
        if len(self._via) < 2:
            self._quat = _turned(self._quat, goal[:4], _TURN * self._period)
        return np.concatenate([self._quat, self._place])


def scripted(task: PolicyTask, seed: int) -> Policy:
    """Return a scripted policy."""
    return Scripted(task)


@lru_cache(maxsize=1)
def _reach_network() -> Mlp:
    return Mlp.load(REACH)


def reach(task: PolicyTask, seed: int) -> Policy:
    """Return a policy that was trained with PPO to move the joints to a goal; it does not know obstacles.

    Raises:
        PolicyError: If the robot does not have the number of joints that the policy was trained with.
    """
    network, limits = _reach_network(), task.scene.limits
    if len(task.start) != network.outputs:
        raise PolicyError("reach", f"was trained for {network.outputs} joints; {task.name} has {len(task.start)}")
    fastest = task.settings.speed * limits.velocity

    def act(observation: Observation) -> Float[Array, " nq"]:
        return fastest * np.clip(network(reach_features(observation.q, observation.qd, observation.goal)), -1.0, 1.0)

    return Acting(act, "joint_velocity")


def reach_features(
    q: Float[Array, " nq"], qd: Float[Array, " nq"], goal: Float[Array, " nq"]
) -> Float[Array, " feature"]:
    """Return the input of the `reach` network: joint distances from the goal, and joint velocities."""
    return np.concatenate([goal - q, qd])


class LeRobotPolicy:
    """Adapter of a LeRobot policy with `reset()` and `select_action(batch)`; install its dependencies yourself.

    A batch has "observation.state" (joint readings), "observation.environment_state" (the rest of
    `Observation.vector`) and "observation.images.CAMERA" (channels first, in [0, 1]). Each has a leading axis of one
    and is converted by `tensor`.

    Args:
        policy: The policy, in evaluation mode. It is reset here, so create one for each episode.
        action: Kind of its actions.
        tensor: Converts an array to a tensor. None is `torch.as_tensor` if torch is imported, else no conversion.
        keys: The policy's own names of batch keys, where they differ.
    """

    def __init__(
        self,
        policy: Any,
        action: str = "joint_position",
        *,
        tensor: Callable[[Array], Any] | None = None,
        keys: Mapping[str, str] | None = None,
    ) -> None:
        check_action(action)
        for method in ("reset", "select_action"):
            if not callable(getattr(policy, method, None)):
                raise PolicyError(type(policy).__name__, f"has no method {method}, which LeRobot's policies have")
        self.action = action
        torch = sys.modules.get("torch")
        self._tensor = tensor or (torch.as_tensor if torch is not None else np.asarray)
        self._policy, self._keys = policy, dict(keys or {})
        policy.reset()

    def __call__(self, observation: Observation, /) -> ArrayLike:
        """Return the first action that the policy selects."""
        nq = len(observation.q)
        batch = {
            "observation.state": observation.q[None].astype(np.float32),
            "observation.environment_state": observation.vector[None, nq:].astype(np.float32),
        }
        for name, picture in observation.images.items():
            scaled = picture.transpose(2, 0, 1)[None].astype(np.float32) / 255.0
            batch[f"observation.images.{name}"] = np.ascontiguousarray(scaled)
        found = self._policy.select_action({self._keys.get(k, k): self._tensor(v) for k, v in batch.items()})
        action = np.asarray(found, dtype=float)
        return action[0] if action.ndim == 2 and len(action) == 1 else action


def _towards(place: Float[Array, " xyz"], target: Float[Array, " xyz"], step: float) -> Float[Array, " xyz"]:
    """Return a position moved towards a target by a step [m], at most to the target."""
    missing = target - place
    length = float(np.linalg.norm(missing))
    return target.copy() if length <= step else place + missing * (step / length)


def _turned(quat: Float[Array, " 4"], target: Float[Array, " 4"], step: float) -> Float[Array, " 4"]:
    """Return an orientation rotated towards a target by an angle [rad], at most to the target."""
    target = target if float(quat @ target) >= 0.0 else -target
    half = float(np.arccos(np.clip(quat @ target, -1.0, 1.0)))
    if 2.0 * half <= step or half < 1e-9:
        return target.copy()
    part = step / (2.0 * half)
    return (np.sin((1.0 - part) * half) * quat + np.sin(part * half) * target) / np.sin(half)

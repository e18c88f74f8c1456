"""Conversion of a policy's actions to drive commands for each simulation step."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from failbench.policies.task import PolicyTask, tool_pose
from graceful_plan.array_types import Array, Float
from graceful_plan.scene.placement import Placement

_ITERATIONS = 3
"""Iterations of inverse kinematics per period; the next period continues."""
_DAMPING = 1e-3
"""Damping of the least squares of inverse kinematics, for twists in m and rad."""


class Servoing:
    """The low-level controller of one episode: it moves the joint targets, within the joints' speed limits.

    Joint targets move linearly between actions. Feed-forward of their speed and of gravity keeps the servos on target,
    as for trajectories. The controller does not know sensor faults, which act in the servos.

    Args:
        task: The task.
    """

    def __init__(self, task: PolicyTask) -> None:
        self._task = task
        self._gravity = GravityTorque(task)
        self._placement = Placement(task.scene)
        self._tool = int(task.scene.model.site(task.scene.tool).id)
        self._dofs = task.world.robot.dofs
        limits, settings = task.scene.limits, task.settings
        self._low, self._high = limits.position.T
        self._most = settings.speed * limits.velocity * settings.period
        """Greatest motion of a joint target per period [rad or m]."""
        self.q = task.start
        """Joint targets."""
        self.speed = np.zeros(len(task.start))
        """Velocities of the joint targets [rad/s or m/s]."""
        self._was = self.q, self.speed, np.zeros(len(task.start))
        """Targets, their velocities and the gravity torques at the beginning of the period."""

    def begin(self, q: Float[Array, " nq"]) -> None:
        """Begin an episode with the robot at `q`."""
        self.q, self.speed = q, np.zeros(len(q))
        self._torque = self._gravity(q)
        self._was = self.q, self.speed, self._torque

    def commands(self, kind: str, action: Float[Array, " n"]) -> Float[Array, "step actuator"]:
        """Return the commands of one period."""
        task = self._task
        steps = task.settings.steps
        self._was = self.q, self.speed, self._torque
        if kind == "command":
            return np.repeat(action[None], steps, axis=0)
        if kind == "joint_velocity":
            target = self.q + task.settings.period * action
        elif kind == "brake":
            target = self.q
        elif kind == "tool_pose":
            target = self._towards(action)
        else:
            target = action
        return self._rows(np.clip(target, self._low, self._high), steps)

    def straight_on(self, steps: int) -> Straightness:
        """Return the straight continuation of the joint targets from `steps` steps after the period's beginning."""
        q, before, torque = self._was
        speed = self.speed if steps else before
        return Straightness(self._task, q + steps * self._task.world.settings.timestep * speed, speed, torque)

    def _rows(self, target: Float[Array, " nq"], steps: int) -> Float[Array, "step actuator"]:
        """Return commands that move the joints linearly to a target, or as far as their speed limits allow."""
        robot, task = self._task.world.robot, self._task
        move = target - self.q
        # Scaled in proportion, to keep the direction.
        move = move * min(1.0, float((self._most / np.maximum(np.abs(move), 1e-12)).min()))
        part = (np.arange(1, steps + 1) / steps)[:, None]
        q, self.speed = self.q + part * move, move / task.settings.period
        before = self._torque
        self.q = q[-1]
        self._torque = self._gravity(self.q) if move.any() else before
        torque = before + part * (self._torque - before)
        command = np.tile(task.standing, (steps, 1))
        command[:, robot.actuators] = (robot.kp * q + robot.kd * self.speed + torque) / robot.gain
        return command

    def _towards(self, pose: Float[Array, " 7"]) -> Float[Array, " nq"]:
        """Return joint targets that bring the tool nearer to a pose, by damped least squares."""
        model, q = self._placement.model, self.q
        J, wanted = np.zeros((6, model.nv)), pose[:4] / max(float(np.linalg.norm(pose[:4])), 1e-9)
        back, turn, missing = np.empty(4), np.empty(4), np.empty(6)
        for _ in range(_ITERATIONS):
            data = self._placement.place(q)
            now = tool_pose(self._task.scene, data)
            missing[:3] = pose[4:] - now[4:]
            mujoco.mju_negQuat(back, now[:4])
            mujoco.mju_mulQuat(turn, wanted, back)
            mujoco.mju_quat2Vel(missing[3:], turn, 1.0)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, J[:3], J[3:], self._tool)
            J_q = J[:, self._dofs]
            step = J_q.T @ np.linalg.solve(J_q @ J_q.T + _DAMPING * np.eye(6), missing)
            q = np.clip(q + step, self._low, self._high)
        return q


class Straightness(NamedTuple):
    """Joint targets that continue with constant velocity."""

    task: PolicyTask
    q: Float[Array, " nq"]
    speed: Float[Array, " nq"]
    torque: Float[Array, " nq"]

    def commands(self, time: Float[Array, " n"], pace: Float[Array, " n"]) -> Float[Array, "n nq"]:
        """Return joint commands at times on this motion's clock [s], for paces of that clock."""
        robot, (low, high) = self.task.world.robot, self.task.scene.limits.position.T
        q = np.clip(self.q + np.outer(time, self.speed), low, high)
        return (robot.kp * q + robot.kd * np.outer(pace, self.speed) + self.torque) / robot.gain


class GravityTorque:
    """Torques that hold the arm and the carried object: a faster equivalent of `RobotDynamics` at rest.

    Args:
        task: The task with the robot.
    """

    def __init__(self, task: PolicyTask) -> None:
        scene = task.scene
        self._placement = Placement(scene)
        model = self._placement.model
        self._dofs, self._tool = task.world.robot.dofs, int(model.site_bodyid[model.site(scene.tool).id])
        self._root = -1 if scene.carried is None else int(model.body(scene.carried.body).id)

    def __call__(self, q: Float[Array, " nq"]) -> Float[Array, " nq"]:
        """Return the torques of the joints [N m or N]."""
        model, data = self._placement.model, self._placement.place(q)
        mujoco.mj_comPos(model, data)
        mujoco.mj_passive(model, data)
        torque = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 0, torque)
        torque -= data.qfrc_passive
        if self._root >= 0:
            J = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, J, None, data.subtree_com[self._root], self._tool)
            torque -= model.body_subtreemass[self._root] * (model.opt.gravity @ J)
        return torque[self._dofs]

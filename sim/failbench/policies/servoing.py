"""From a policy's actions to what the drives get, for each step of the simulation."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from failbench.policies.task import PolicyTask, tool_pose
from graceful_plan.array_types import Float
from graceful_plan.scene.placement import Placement

Array = np.ndarray

_ITERATIONS = 3
"""Of inverse kinematics a period; the next one goes on."""
_DAMPING = 1e-3
"""Of its least squares, as of twists in m and rad."""


class Servoing:
    """The low-level controller of one episode: moves where the joints are to be, within their limits of speed.

    Between two actions the joints' targets move evenly; feed-forward of that speed and of gravity keeps the servos on
    them, as it does for trajectories. It knows nothing of broken sensors: these are in the servos.

    Args:
        task: What is to be done.
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
        """How far a joint's target moves in a period at most [rad or m]."""
        self.q = task.start
        """Where the joints are to be."""
        self.speed = np.zeros(len(task.start))
        """How fast they are to move now [rad/s or m/s]."""
        self._was = self.q, self.speed, np.zeros(len(task.start))
        """Both when the period began, and gravity's torques then."""

    def begin(self, q: Float[Array, " nq"]) -> None:
        """Begin an episode in which the robot stands at `q`."""
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
        """Return how the joints would go on from so many steps after the period's beginning, if nothing more came."""
        q, before, torque = self._was
        speed = self.speed if steps else before
        return Straightness(self._task, q + steps * self._task.world.settings.timestep * speed, speed, torque)

    def _rows(self, target: Float[Array, " nq"], steps: int) -> Float[Array, "step actuator"]:
        """Return commands that take the joints evenly to a target, or as far as their speed allows."""
        robot, task = self._task.world.robot, self._task
        move = target - self.q
        # All in proportion, so that the direction stays.
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
        """Return joints with which the tool is nearer to a pose, by damped least squares from where they are to be."""
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
    """Joints that go on as they move at a moment."""

    task: PolicyTask
    q: Float[Array, " nq"]
    speed: Float[Array, " nq"]
    torque: Float[Array, " nq"]

    def commands(self, time: Float[Array, " n"], pace: Float[Array, " n"]) -> Float[Array, "n nq"]:
        """Return commands of the joints at times on this motion's clock [s], and paces of that clock."""
        robot, (low, high) = self.task.world.robot, self.task.scene.limits.position.T
        q = np.clip(self.q + np.outer(time, self.speed), low, high)
        return (robot.kp * q + robot.kd * np.outer(pace, self.speed) + self.torque) / robot.gain


class GravityTorque:
    """Torques that hold the arm with what it carries: `RobotDynamics` at rest, several times sooner.

    Args:
        task: Whose robot.
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

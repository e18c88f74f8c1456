"""Commands of the healthy controller: servo targets of a motion, and of a robot that stands still."""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.simulated.rolling import PLANAR, lifted
from failbench.simulated.world import World
from graceful_plan import Trajectory
from graceful_plan.array_types import Array, Float
from graceful_plan.timing.dynamics import RobotDynamics


def motion_commands(trajectory: Trajectory, world: World, steps: int) -> Float[Array, "step actuator"]:
    """Return the healthy commands: positions, plus feed-forward torques as offsets of the servo targets."""
    times = trajectory.t[0] + np.arange(steps + 1) * world.settings.timestep
    q, qd, qdd = trajectory.at(np.minimum(times, trajectory.t[-1]))
    qd[-1] = qdd[-1] = 0.0  # the last row is held after the end
    command = np.tile(standing(world), (steps + 1, 1))
    command[:, world.robot.actuators] = joint_commands(world, q, qd, qdd)
    command[:, world.robot.gripper_actuators] = world.robot.grip_closed
    return command


def joint_commands(
    world: World, q: Float[Array, "n nq"], qd: Float[Array, "n nq"], qdd: Float[Array, "n nq"]
) -> Float[Array, "n driven"]:
    """Return the servo commands of the joints for a motion."""
    robot, dynamics = world.robot, RobotDynamics(world.scene)
    if world.settings.control == "servo":
        qdd = np.zeros_like(qdd)  # servo feed-forward covers speed and gravity, not the arm's inertia
    at_rest = np.zeros_like(q[0])
    torque = np.array(
        [
            dynamics(a, at_rest if world.settings.control == "servo" else b, c)
            for a, b, c in zip(q, qd, qdd, strict=True)
        ]
    )
    if world.rolling is None:
        return (robot.kp * q + robot.kd * qd + torque) / robot.gain
    # The base's loop writes the wheels' commands; here they stay zero.
    n = len(world.rolling.base.wheels)
    arm = slice(n, None)
    command = np.zeros((len(q), len(robot.joints)))
    joints = robot.kp[arm] * q[:, PLANAR:] + robot.kd[arm] * qd[:, PLANAR:] + torque[:, PLANAR:]
    command[:, arm] = joints / robot.gain[arm]
    return command


def standing(world: World) -> Float[Array, " actuator"]:
    """Return commands with which every position servo holds its joint at the scene's home position."""
    model = world.model
    data = mujoco.MjData(model)
    data.qpos[:] = lifted(world.scene, model, world.scene.home_qpos)
    mujoco.mj_fwdPosition(model, data)
    gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm
    servo = (bias[:, 1] < 0.0) & (gain != 0.0)
    command = np.zeros(model.nu)
    command[servo] = -(bias[servo, 0] + bias[servo, 1] * data.actuator_length[servo]) / gain[servo]
    return command

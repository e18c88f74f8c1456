"""Driving a planned motion on wheels: a controller follows it, and what comes of that is measured."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from failbench.wheels.wheeled import TIMESTEP, Wheeled, wheeled
from graceful_plan import Scene, Trajectory
from graceful_plan.array_types import Float

Array = np.ndarray

_SETTLES = 0.5
"""How long the robot is watched after the end [s]."""


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Gains of a controller: v = v_r cos e_h + k_x e_x, omega = omega_r + v_r (k_y e_y + k_h sin e_h).

    Y. Kanayama et al., "A stable tracking control method for an autonomous mobile robot", ICRA 1990.

    Args:
        k_x: Along the heading [1/s].
        k_y: Across it [1/m^2].
        k_h: Of the heading [1/m].
        k_rate: Of the rate of turning as a gyro measures it, added to omega: a skid-steer slips less the faster it is.
    """

    k_x: float = 4.0
    k_y: float = 60.0
    k_h: float = 15.0
    k_rate: float = 2.0


@dataclass(frozen=True, eq=False)
class Driven:
    """How well a base followed a motion.

    | field    | meaning                                                       | unit        |
    |----------|---------------------------------------------------------------|-------------|
    | t        | times of samples                                              | s           |
    | pose     | where the base was: x, y, heading                             | m, m, rad   |
    | error    | distance to where it should have been                         | m           |
    | touched  | names of bodies of the surroundings that it touched           |             |
    """

    t: Float[Array, " sample"]
    pose: Float[Array, "sample 3"]
    error: Float[Array, " sample"]
    touched: tuple[str, ...]


def drive(trajectory: Trajectory, scene: Scene, controller: Tracking | None = None) -> Driven:
    """Follow a motion of a base on wheels that turn.

    Args:
        trajectory: As `plan` returned it.
        scene: Where it was planned.
        controller: Gains of what follows it.

    Raises:
        UnsupportedError: If the scene's robot cannot be put on wheels.
    """
    wheels, gains = wheeled(scene), controller or Tracking()
    t = np.arange(0.0, trajectory.duration + _SETTLES, TIMESTEP)
    planned = trajectory.at(trajectory.t[0] + np.minimum(t, trajectory.duration))
    data = wheels.placed(planned.q[0], 0.0, 0.0)
    pose, touched = np.zeros((len(t), 3)), set()
    for k in range(len(t)):
        pose[k] = wheels.pose(data)
        v, omega = _command(gains, pose[k], planned.q[k], planned.qd[k])
        omega += gains.k_rate * (omega - float(data.qvel[wheels.dof + 5]))
        data.ctrl[wheels.motor] = wheels.wheel_rates(v, omega)
        mujoco.mj_step(wheels.model, data)
        touched |= _touches(wheels, data)
    error = np.linalg.norm(pose[:, :2] - planned.q[:, :2], axis=1)
    return Driven(t, pose, error, tuple(sorted(touched)))


def _command(
    gains: Tracking, pose: Float[Array, " 3"], q: Float[Array, " nq"], qd: Float[Array, " nq"]
) -> tuple[float, float]:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = q[0] - pose[0], q[1] - pose[1]
    along, across = c * dx + s * dy, -s * dx + c * dy
    heading = float(np.remainder(q[2] - pose[2] + np.pi, 2.0 * np.pi) - np.pi)
    v = float(qd[0] * np.cos(q[2]) + qd[1] * np.sin(q[2]))
    speed = v * np.cos(heading) + gains.k_x * along
    turn = float(qd[2]) + v * gains.k_y * across + (abs(v) * gains.k_h + gains.k_x) * np.sin(heading)
    return float(speed), float(turn)


def _touches(wheels: Wheeled, data: mujoco.MjData) -> set[str]:
    found = set()
    for k in range(data.ncon):
        first, second = int(data.contact.geom1[k]), int(data.contact.geom2[k])
        if data.contact.dist[k] > 0.0 or (first in wheels.robot) == (second in wheels.robot):
            continue
        other = second if first in wheels.robot else first
        if other not in wheels.floor:
            found.add(wheels.model.body(int(wheels.model.geom_bodyid[other])).name or "world")
    return found

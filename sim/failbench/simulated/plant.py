"""One simulated robot, as a fault sees it: what it may read, and what it may break."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from failbench.simulated.robot import Robot
from graceful_plan.exceptions import UnknownNameError

if TYPE_CHECKING:
    from failbench.simulated.world import World

Array = np.ndarray


@dataclass(kw_only=True, eq=False)
class Plant:
    """One simulation from the onset of a fault on. Arrays are live: what is written is what is simulated next.

    | field       | meaning                                                                                  |
    |-------------|------------------------------------------------------------------------------------------|
    | robot       | where the robot's parts are in MuJoCo's arrays                                           |
    | joints      | indices of the joints that the fault strikes                                             |
    | gripper     | whether it strikes the gripper                                                           |
    | dt          | time step [s]                                                                            |
    | rng         | the only source of randomness                                                            |
    | qpos        | positions of everything, now                                                             |
    | qvel        | velocities of everything, now                                                            |
    | eq_active   | which equality constraints hold                                                          |
    | command     | commands of all actuators, a row a step; row 0 is the first step after the onset         |
    | healthy     | the same as a healthy robot gets them; read only                                         |
    | past        | commands before the onset, the latest last; read only                                    |
    | paced       | commands of the joints if the motion goes on at another pace: from times on the clock of  |
    |             | the motion since the onset [s], pace, and how fast that changes [1/s]                    |
    | fields      | fields of this simulation's model that may be written                                    |
    | measured    | positions and velocities of the joints in the healthy run up to the onset, the latest     |
    |             | last; read only                                                                          |
    | world       | where; None for a robot alone                                                            |
    | walk        | where those who move are before each step and after the last, see `walkers.Walk`         |
    | xfrc        | force and torque on each body in W, until they are changed                               |
    | planned     | positions of the joints that the motion has at times since the onset [s]                 |
    | step        | steps since the onset                                                                    |
    | lag         | steps by which the speeds that a base is told arrive late                                |
    | memory      | whatever the fault wants to remember                                                     |
    | misreading  | what `misread` was told last, for whoever reads sensors: step, joints, error; None for none |
    """

    robot: Robot
    joints: Array
    gripper: bool
    dt: float
    rng: np.random.Generator
    qpos: Array
    qvel: Array
    eq_active: Array
    command: Array
    healthy: Array
    past: Array
    paced: Callable[[Array, Array, Array], Array]
    fields: Mapping[str, Array]
    measured: Array = field(default_factory=lambda: np.zeros((0, 2, 0)))
    world: World | None = None
    walk: Array = field(default_factory=lambda: np.zeros((0, 0)))
    xfrc: Array = field(default_factory=lambda: np.zeros((0, 6)))
    planned: Callable[[Array], Array] = lambda time: np.zeros((len(time), 0))
    step: int = 0
    lag: int = 0
    memory: dict[str, Any] = field(default_factory=dict)
    misreading: tuple[int, Array, Array] | None = None

    def __getitem__(self, name: str) -> Array:
        """Return a field of this simulation's MuJoCo model, to write into.

        Raises:
            UnknownNameError: If the fault has not named it in its `FIELDS`.
        """
        if name not in self.fields:
            raise UnknownNameError("model field (the fault's FIELDS name those it may write)", name, self.fields)
        return self.fields[name]

    @property
    def time(self) -> float:
        """Time since the onset [s]."""
        return self.step * self.dt

    @property
    def q(self) -> Array:
        """Positions of the planned joints now [rad or m]."""
        return self.qpos[self.robot.qpos]

    @property
    def qd(self) -> Array:
        """Velocities of the planned joints now [rad/s or m/s]."""
        return self.qvel[self.robot.dofs]

    @property
    def wheels(self) -> Array:
        """Indices of the driven joints that are wheels of a base, whose controller closes its loop on the way."""
        return np.array([wheel for side in self.robot.together for wheel in side], dtype=int)

    @property
    def ahead(self) -> Array:
        """Commands from the next step on, to write into [step, actuator]."""
        return self.command[self.step :]

    def misread(self, joints: Array, error: Array) -> None:
        """Let position sensors read wrong by `error` from the next step on.

        A servo computes gain command - kp reading - kd speed, so an error of the reading acts like an opposite error of
        the command, times kp / gain.

        Args:
            joints: Indices of planned joints.
            error: Reading minus truth [rad or m], for each step to come and each of these joints.
        """
        robot = self.robot
        self.misreading = self.step, joints, error
        self.ahead[:, robot.actuators[joints]] -= error * (robot.kp[joints] / robot.gain[joints])

    def lock(self, joint: int, position: float) -> None:
        """Hold a planned joint at a position with a constraint that is as stiff as the time step allows.

        Needs the field "eq_data".
        """
        constraint = self.robot.locks[joint]
        self["eq_data"][constraint, 0] = position - self.robot.reference[joint]
        self.eq_active[constraint] = 1

    def release(self) -> None:
        """Let go of the carried object: open the gripper from the next step on; a weld that holds it is cut."""
        self.ahead[:, self.robot.gripper_actuators] = self.robot.grip_open
        self.cut_weld()

    def cut_weld(self) -> None:
        """Cut the weld that stands for the grasp, if there is one; nothing mends it."""
        if self.robot.weld >= 0:
            self.eq_active[self.robot.weld] = 0

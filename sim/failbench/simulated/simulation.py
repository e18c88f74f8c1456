"""One simulated robot as faults see it: the state they read and the arrays they write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from failbench.simulated.robot import Robot
from graceful_plan.array_types import Array
from graceful_plan.exceptions import UnknownNameError

if TYPE_CHECKING:
    from failbench.simulated.world import World


@dataclass(kw_only=True, eq=False)
class Simulation:
    """One simulation from the onset of a fault on. Its arrays are live: writing to them changes the next step.

    | field       | meaning                                                                                  |
    |-------------|------------------------------------------------------------------------------------------|
    | robot       | where the robot's parts are in MuJoCo's arrays                                           |
    | joints      | indices of the joints that the fault strikes                                             |
    | gripper     | whether it strikes the gripper                                                           |
    | dt          | time step [s]                                                                            |
    | rng         | the only source of randomness                                                            |
    | qpos        | current positions of the whole model                                                     |
    | qvel        | current velocities of the whole model                                                    |
    | eq_active   | which equality constraints are active                                                    |
    | command     | commands of all actuators, one row per step; row 0 is the first step after the onset     |
    | healthy     | commands that a healthy robot gets, in the same layout; read only                        |
    | past        | commands before the onset, the latest last; read only                                    |
    | paced       | function that returns joint commands at another pace, for times on the motion's clock    |
    |             | since the onset [s], pace, and pace rate [1/s]                                           |
    | fields      | writable fields of this simulation's model                                               |
    | measured    | positions and velocities of the joints in the healthy run up to the onset, the latest     |
    |             | last; read only                                                                          |
    | world       | the simulated world; None for a robot alone                                              |
    | walk        | poses of moving entities before each step and after the last, see `walkers.EntityPoses`         |
    | xfrc        | force and torque on each body in W; they act until changed                               |
    | planned     | function that returns the planned joint positions at times since the onset [s]           |
    | stopped     | function that returns joint commands of the next stop planned ahead after the onset, for  |
    |             | the time between two such stops [s] and times since the onset [s]                        |
    | step        | steps since the onset                                                                    |
    | lag         | delay of a base's commanded speeds, in steps                                             |
    | memory      | state that the fault keeps between calls                                                 |
    | misreading  | arguments of the last `misread`: step, joints, error; None if there was none             |
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
    stopped: Callable[[float, Array], Array] = lambda every, time: np.zeros((len(time), 0))
    step: int = 0
    lag: int = 0
    memory: dict[str, Any] = field(default_factory=dict)
    misreading: tuple[int, Array, Array] | None = None

    def __getitem__(self, name: str) -> Array:
        """Return a writable field of this simulation's MuJoCo model.

        Raises:
            UnknownNameError: If the field is not in the fault's `FIELDS`.
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
        """Current positions of the planned joints [rad or m]."""
        return self.qpos[self.robot.qpos]

    @property
    def qd(self) -> Array:
        """Current velocities of the planned joints [rad/s or m/s]."""
        return self.qvel[self.robot.dofs]

    @property
    def wheels(self) -> Array:
        """Indices of the driven joints that are wheels of a base; the base's controller closes a loop around them."""
        return np.array([wheel for side in self.robot.together for wheel in side], dtype=int)

    @property
    def ahead(self) -> Array:
        """Commands from the next step on, writable [step, actuator]."""
        return self.command[self.step :]

    def misread(self, joints: Array, error: Array) -> None:
        """Add `error` to the readings of position sensors from the next step on.

        A servo computes gain command - kp reading - kd speed, so an error of the reading acts like an opposite error of
        the command, times kp / gain.

        Args:
            joints: Indices of planned joints.
            error: Reading minus true position [rad or m], for each further step and each of these joints.
        """
        robot = self.robot
        self.misreading = self.step, joints, error
        self.ahead[:, robot.actuators[joints]] -= error * (robot.kp[joints] / robot.gain[joints])

    def lock(self, joint: int, position: float) -> None:
        """Hold a planned joint at a position with a constraint as stiff as the time step allows.

        Needs the field "eq_data".
        """
        constraint = self.robot.locks[joint]
        self["eq_data"][constraint, 0] = position - self.robot.reference[joint]
        self.eq_active[constraint] = 1

    def release(self) -> None:
        """Release the carried object: open the gripper from the next step on and cut the weld, if any."""
        self.ahead[:, self.robot.gripper_actuators] = self.robot.grip_open
        self.cut_weld()

    def cut_weld(self) -> None:
        """Cut the weld that models the grasp, if there is one. It stays cut."""
        if self.robot.weld >= 0:
            self.eq_active[self.robot.weld] = 0

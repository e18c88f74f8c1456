"""The parts of a robot that can break, by their place in MuJoCo's arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.exceptions import SettingError, UnknownNameError

Array = np.ndarray

GROUPS = ("any", "all", "gripper", "robot")
"""What can stand for parts of the robot besides the names of its joints."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """Ids of the joints and actuators of the arm and the gripper.

    | field             | meaning                                                                      | shape |
    |-------------------|------------------------------------------------------------------------------|-------|
    | joints            | names of the planned joints, from the base to the tool                       | nq    |
    | joint_ids         | their ids                                                                    | nq    |
    | qpos              | their addresses in qpos                                                      | nq    |
    | reference         | their positions in the model's own pose, which locks count from [rad or m]   | nq    |
    | dofs              | their addresses in qvel                                                      | nq    |
    | actuators         | the actuator that drives each                                                | nq    |
    | locks             | for each an equality constraint, inactive, that holds it where it is told to | nq    |
    | kp                | stiffness of each joint's servo [N m/rad]                                    | nq    |
    | kd                | damping of each joint's servo [N m s/rad]                                    | nq    |
    | gain              | torque of each joint's actuator per unit of its command [N m]                | nq    |
    | acceleration      | greatest acceleration of each joint that motions have [rad/s^2]              | nq    |
    | gripper_joints    | ids of the fingers' joints                                                   |       |
    | gripper_dofs      | their addresses in qvel                                                      |       |
    | gripper_actuators | ids of the gripper's actuators                                               |       |
    | grip_open         | command of each gripper actuator that opens the gripper                      |       |
    | grip_closed       | the one of a healthy robot: closed if the fingers hold something             |       |
    | grip_clear        | opening at which fingers let go, over the way from closed to open            |       |
    | pads              | ids of the geoms of the fingers                                              |       |
    | weld              | the equality constraint that holds the carried object; -1 if the fingers do  |       |
    | together          | groups of joints that one motor drives: what strikes one strikes all         |       |
    """

    joints: tuple[str, ...]
    joint_ids: Array
    qpos: Array
    reference: Array
    dofs: Array
    actuators: Array
    locks: Array
    kp: Array
    kd: Array
    gain: Array
    acceleration: Array
    gripper_joints: Array
    gripper_dofs: Array
    gripper_actuators: Array
    grip_open: Array
    grip_closed: Array
    grip_clear: float
    pads: Array
    weld: int
    together: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.flags.writeable = False  # one robot for all rollouts: no fault may change it for the others

    def struck(
        self, targets: Sequence[str], rng: np.random.Generator, rates: Sequence[float] = ()
    ) -> tuple[Array, bool]:
        """Return which joints (indices into `joints`) and whether the gripper are meant by `targets`.

        Args:
            targets: Names of joints, or "any" (one drawn from `rng`), "all", "gripper", "robot".
            rng: Where the draw comes from.
            rates: How often each joint is drawn, relative to the others; all alike if empty.

        Raises:
            UnknownNameError: If a target is neither a joint nor such a word.
            SettingError: If there is not one rate for each joint.
        """
        self.check_targets(targets, rates)
        drawn = int(rng.integers(len(self.joints)))  # always, so that what follows does not depend on the targets
        if len(rates):  # from a stream of its own, for the same reason
            share = np.cumsum(rates) / np.sum(rates)
            drawn = int(np.searchsorted(share, rng.spawn(1)[0].random(), side="right"))
        chosen: set[int] = set()
        for target in targets:
            if target in ("all", "robot"):
                chosen |= set(range(len(self.joints)))
            elif target == "any":
                chosen.add(drawn)
            elif target != "gripper":
                chosen.add(self.joints.index(target))
        for group in self.together:
            if chosen.intersection(group):
                chosen.update(group)
        return np.array(sorted(chosen), dtype=int), any(t in ("gripper", "robot") for t in targets)

    def check_targets(self, targets: Sequence[str], rates: Sequence[float] = ()) -> None:
        """Raise UnknownNameError if a target is neither a joint nor one of "any", "all", "gripper", "robot".

        Raises:
            UnknownNameError: As said.
            SettingError: If there are rates, but not one for each joint.
        """
        if len(rates) not in (0, len(self.joints)):
            raise SettingError("rates", tuple(rates), f"{len(self.joints)} of them, one for each of {self.joints}")
        for target in targets:
            if target not in self.joints and target not in GROUPS:
                raise UnknownNameError("target", target, {*self.joints, *GROUPS})

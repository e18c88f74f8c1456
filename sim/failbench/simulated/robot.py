"""Parts of a robot that can break, by their indices in MuJoCo's arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError, UnknownNameError

GROUPS = ("any", "all", "gripper", "robot")
"""Target names that stand for groups of parts, in addition to joint names."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """Ids of the joints and actuators of the arm and the gripper.

    | field             | meaning                                                                      | shape |
    |-------------------|------------------------------------------------------------------------------|-------|
    | joints            | names of the planned joints, from the base to the tool                       | nq    |
    | joint_ids         | ids of the planned joints                                                    | nq    |
    | qpos              | addresses of the planned joints in qpos                                      | nq    |
    | reference         | joint positions in the model's reference pose, zero of the locks [rad or m]  | nq    |
    | dofs              | addresses of the planned joints in qvel                                      | nq    |
    | actuators         | actuator of each planned joint                                               | nq    |
    | locks             | inactive equality constraint that can hold each joint at a given position    | nq    |
    | kp                | stiffness of each joint's servo [N m/rad]                                    | nq    |
    | kd                | damping of each joint's servo [N m s/rad]                                    | nq    |
    | gain              | torque of each joint's actuator per unit of its command [N m]                | nq    |
    | acceleration      | acceleration limit of each joint in motions [rad/s^2]                        | nq    |
    | gripper_joints    | ids of the fingers' joints                                                   |       |
    | gripper_dofs      | addresses of the fingers' joints in qvel                                     |       |
    | gripper_actuators | ids of the gripper's actuators                                               |       |
    | grip_open         | command of each gripper actuator that opens the gripper                      |       |
    | grip_closed       | command of each in healthy operation: closed if the fingers hold an object   |       |
    | grip_clear        | opening at which fingers release the object, from closed (0) to open (1)     |       |
    | pads              | ids of the geoms of the fingers                                              |       |
    | weld              | the equality constraint that holds the carried object; -1 if the fingers do  |       |
    | together          | groups of joints with a common motor: a fault of one strikes all             |       |
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
                array.flags.writeable = False  # all rollouts share one robot

    def struck(
        self, targets: Sequence[str], rng: np.random.Generator, rates: Sequence[float] = ()
    ) -> tuple[Array, bool]:
        """Return the joints (indices into `joints`) that `targets` name, and whether they include the gripper.

        Args:
            targets: Names of joints, or "any" (one drawn from `rng`), "all", "gripper", "robot".
            rng: Generator of the draw.
            rates: Relative frequency of each joint in the draw; equal if empty.

        Raises:
            UnknownNameError: If a target is neither a joint nor a word of `GROUPS`.
            SettingError: If the number of rates differs from the number of joints.
        """
        self.check_targets(targets, rates)
        drawn = int(rng.integers(len(self.joints)))  # always drawn, so that later draws do not depend on the targets
        if len(rates):  # from a separate stream, for the same reason
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
        """Check that each target is a joint or a word of `GROUPS`.

        Raises:
            UnknownNameError: If a target is neither.
            SettingError: If there are rates and their number differs from the number of joints.
        """
        if len(rates) not in (0, len(self.joints)):
            raise SettingError("rates", tuple(rates), f"{len(self.joints)} of them, one for each of {self.joints}")
        for target in targets:
            if target not in self.joints and target not in GROUPS:
                raise UnknownNameError("target", target, {*self.joints, *GROUPS})

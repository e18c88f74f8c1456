"""What faults do to the drives that they strike: weaken them, let joints rub, see whether the gripper still holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from failbench.simulated.plant import Plant
from failbench.simulated.robot import Robot
from failbench.simulated.world import World
from graceful_plan.exceptions import UnsupportedError

Array = np.ndarray

DRIVE = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
"""Model fields that `scale_torque` needs."""
GRIP = ("eq_obj2id", "body_mass", "geom_friction")
"""Model fields that `cut_overloaded_weld` needs besides."""

FRICTION = ("dof_frictionloss", "dof_solref", "dof_solimp", "actuator_forcerange")
"""Model fields that `add_friction` needs."""

BRAKE_TORQUE = 1.5
"""Torque up to which a brake holds, as a multiple of what the joint's motor can give."""

BRAKES = FRICTION
"""Model fields that `close_brakes` needs."""

_GRAVITY = 9.81
_STIFF = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance of friction that lets a joint at rest creep as little as the solver allows."""


def actuators(plant: Plant) -> Array:
    """Return the ids of the actuators that the fault strikes."""
    robot = plant.robot
    return np.concatenate(
        [robot.actuators[plant.joints], robot.gripper_actuators[: len(robot.gripper_actuators) * plant.gripper]]
    )


def add_friction(plant: Plant, share: float) -> Array:
    """Let the struck joints rub, with dry friction of a share of the greatest torque of their motors.

    Needs the fields `FRICTION`.

    Returns:
        The friction of each of them [N m or N].

    Raises:
        UnsupportedError: If the greatest torque of one of them is not known.
    """
    limit = _greatest(plant["actuator_forcerange"], plant.robot, plant.joints)
    torque = share * limit
    _rub(plant.__getitem__, plant.robot.dofs[plant.joints], torque, plant.dt)
    return torque


def close_brakes(fields: Mapping[str, Array], world: World) -> None:
    """Hold all joints, the fingers' excepted, by brakes, and take the power from their drives.

    Brakes are as strong as a healthy robot's, whatever is broken: springs close them.

    Args:
        fields: Live model fields of one simulation: `BRAKES`, as they are without brakes.
        world: Where.

    Raises:
        UnsupportedError: If the greatest torque of a joint is not known.
    """
    robot, model = world.robot, world.model
    limit = _greatest(model.actuator_forcerange, robot, np.arange(len(robot.joints)))
    _rub(fields.__getitem__, robot.dofs, BRAKE_TORQUE * limit, float(model.opt.timestep))
    fields["actuator_forcerange"][robot.actuators] = 0.0


def _greatest(force_range: Array, robot: Robot, joints: Array) -> Array:
    """Return what the motors of joints can give, which has to be known."""
    limit = force_range[robot.actuators[joints], 1]
    for joint in joints[limit <= 0.0]:
        raise UnsupportedError(f"the greatest torque of the joint {robot.joints[joint]!r} is not known; tell the scene")
    return limit


def _rub(fields: Callable[[str], Array], dofs: Array, torque: Array, dt: float) -> None:
    """Add dry friction to degrees of freedom, as stiff as the time step allows."""
    fields("dof_frictionloss")[dofs] += torque
    fields("dof_solref")[dofs] = [2.0 * dt, 1.0]
    fields("dof_solimp")[dofs] = _STIFF


def scale_response(plant: Plant, share: float) -> None:
    """Let the struck drives answer to commands, errors and speeds with a share of what they should.

    Needs "actuator_gainprm" and "actuator_biasprm".
    """
    struck = actuators(plant)
    plant["actuator_gainprm"][struck] *= share
    plant["actuator_biasprm"][struck] *= share


def scale_torque(plant: Plant, share: float) -> None:
    """Let the struck drives give a share of their torque: of what is asked for, and of the most they can give.

    Needs the fields `DRIVE`.
    """
    scale_response(plant, share)
    plant["actuator_forcerange"][actuators(plant)] *= share


def weaken(plant: Plant, share: float) -> None:
    """Let the struck drives give a share of their torque; fingers that get too weak lose what a weld stands for.

    Needs the fields `DRIVE` and `GRIP`.
    """
    scale_torque(plant, share)
    cut_overloaded_weld(plant)


def hold_grip(plant: Plant) -> None:
    """Leave the gripper as it was told to be at the onset, deaf to later commands."""
    grippers = plant.robot.gripper_actuators
    plant.ahead[:, grippers] = plant.healthy[0, grippers]


def cut_overloaded_weld(plant: Plant, share: float = 1.0) -> None:
    """Cut the weld that stands for the grasp if fingers would not hold the object's weight any more.

    Fingers hold it as long as the friction coefficient times the sum of their normal forces carries its weight. A hand
    without drives holds until nothing is left. Needs the fields `GRIP` and "actuator_forcerange".

    Args:
        plant: Where.
        share: Part of the greatest force that the fingers still press with.
    """
    robot = plant.robot
    if robot.weld < 0 or not plant.gripper:
        return
    if not len(robot.gripper_actuators):
        if share == 0.0:
            plant.cut_weld()
        return
    carried = plant["eq_obj2id"][robot.weld]
    friction = plant["geom_friction"][robot.pads, 0].max(initial=0.0)
    grip = plant["actuator_forcerange"][robot.gripper_actuators, 1].sum()
    if friction * share * grip < plant["body_mass"][carried] * _GRAVITY:
        plant.cut_weld()

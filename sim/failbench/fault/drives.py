"""Effects of faults on drives: reduced torque, joint friction, brakes, and the loss of a weld-based grasp."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from failbench.simulated.robot import Robot
from failbench.simulated.simulation import Simulation
from failbench.simulated.world import World
from graceful_plan.array_types import Array
from graceful_plan.exceptions import UnsupportedError

DRIVE = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
"""Model fields that `scale_torque` needs."""
GRIP = ("eq_obj2id", "body_mass", "geom_friction")
"""Further model fields that `cut_overloaded_weld` needs."""

FRICTION = ("dof_frictionloss", "dof_solref", "dof_solimp", "actuator_forcerange")
"""Model fields that `add_friction` needs."""

BRAKE_TORQUE = 1.5
"""Greatest holding torque of a brake, as a multiple of the joint motor's torque limit."""

BRAKES = FRICTION
"""Model fields that `close_brakes` needs."""

_GRAVITY = 9.81
_STIFF = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Solver impedance (solimp) of joint friction, as hard as the solver allows, so that a joint at rest barely creeps."""


def actuators(plant: Simulation) -> Array:
    """Return the ids of the actuators that the fault strikes."""
    robot = plant.robot
    return np.concatenate(
        [robot.actuators[plant.joints], robot.gripper_actuators[: len(robot.gripper_actuators) * plant.gripper]]
    )


def add_friction(plant: Simulation, share: float) -> Array:
    """Add dry friction to the struck joints, as a fraction `share` of their motors' torque limits.

    Needs the fields `FRICTION`.

    Returns:
        Friction torque of each struck joint [N m or N].

    Raises:
        UnsupportedError: If the torque limit of a struck joint is not known.
    """
    limit = _greatest(plant["actuator_forcerange"], plant.robot, plant.joints)
    torque = share * limit
    _rub(plant.__getitem__, plant.robot.dofs[plant.joints], torque, plant.dt)
    return torque


def close_brakes(fields: Mapping[str, Array], world: World) -> None:
    """Hold all joints except the fingers by brakes, and remove the power from their drives.

    The brakes close by springs, so they have the full strength of a healthy robot's whatever else is broken.

    Args:
        fields: Live model fields `BRAKES` of one simulation, with the values they have without brakes.
        world: World of the simulation.

    Raises:
        UnsupportedError: If the torque limit of a joint is not known.
    """
    robot, model = world.robot, world.model
    limit = _greatest(model.actuator_forcerange, robot, np.arange(len(robot.joints)))
    _rub(fields.__getitem__, robot.dofs, BRAKE_TORQUE * limit, float(model.opt.timestep))
    fields["actuator_forcerange"][robot.actuators] = 0.0


def _greatest(force_range: Array, robot: Robot, joints: Array) -> Array:
    """Return the torque limits of the joints' motors; raise UnsupportedError if one is not known."""
    limit = force_range[robot.actuators[joints], 1]
    for joint in joints[limit <= 0.0]:
        raise UnsupportedError(
            f"the torque limit of the joint {robot.joints[joint]!r} is not known; set it in the scene"
        )
    return limit


def _rub(fields: Callable[[str], Array], dofs: Array, torque: Array, dt: float) -> None:
    """Add dry friction to degrees of freedom, as stiff as the time step allows."""
    fields("dof_frictionloss")[dofs] += torque
    fields("dof_solref")[dofs] = [2.0 * dt, 1.0]
    fields("dof_solimp")[dofs] = _STIFF


def scale_response(plant: Simulation, share: float) -> None:
    """Scale the response of the struck drives to commands, position errors and speeds by `share`.

    Needs "actuator_gainprm" and "actuator_biasprm".
    """
    struck = actuators(plant)
    plant["actuator_gainprm"][struck] *= share
    plant["actuator_biasprm"][struck] *= share


def scale_torque(plant: Simulation, share: float) -> None:
    """Scale the torque of the struck drives by `share`: both their response and their torque limit.

    Needs the fields `DRIVE`.
    """
    scale_response(plant, share)
    plant["actuator_forcerange"][actuators(plant)] *= share


def weaken(plant: Simulation, share: float) -> None:
    """Scale the torque of the struck drives by `share`; fingers that get too weak release a grasp modelled by a weld.

    Needs the fields `DRIVE` and `GRIP`.
    """
    scale_torque(plant, share)
    cut_overloaded_weld(plant)


def hold_grip(plant: Simulation) -> None:
    """Freeze the gripper's commands at their values at the onset."""
    grippers = plant.robot.gripper_actuators
    plant.ahead[:, grippers] = plant.healthy[0, grippers]


def cut_overloaded_weld(plant: Simulation, share: float = 1.0) -> None:
    """Cut the weld that models the grasp once the fingers could no longer hold the object's weight.

    The fingers hold as long as the friction coefficient times the sum of their normal forces is at least the weight. A
    gripper without actuators holds until `share` is 0. Needs the fields `GRIP` and "actuator_forcerange".

    Args:
        plant: The simulated robot.
        share: Remaining finger force, as a fraction of the current limit.
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

"""Interface of a policy: a callable from observations to actions."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from failbench.policies.task import PolicyTask
from graceful_plan import GracefulPlanError
from graceful_plan.array_types import Array, Float, UInt8
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.path import real_array

ACTIONS: Mapping[str, str] = MappingProxyType(
    {
        "joint_position": "joint positions at the end of the period [rad or m]",
        "joint_velocity": "joint velocities during the period [rad/s or m/s]",
        "tool_pose": "tool pose at the end of the period, wxyz_xyz in W",
        "command": "commands of all actuators, as the simulated drives take them",
        "brake": "empty: the brakes of all joints close permanently, and their drives lose power",
    }
)
"""Kinds of actions, and their content."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """Observation of a policy, with the errors of broken sensors and delays. Objects and pictures are not affected.

    The desired values are internal to the robot, free of sensor errors and delays. Actions of the kind "command" bypass
    the low-level controller, whose desired values then stay at their initial ones.

    | field       | meaning                                                      | unit           | shape        |
    |-------------|--------------------------------------------------------------|----------------|--------------|
    | time        | since the beginning of the episode, on the policy's clock    | s              |              |
    | q           | position readings                                            | rad or m       | nq           |
    | qd          | speed readings                                               | rad/s or m/s   | nq           |
    | torque      | torques of the joints' drives; NaN at the beginning           | N m or N       | nq           |
    | opening     | mean position of the gripper's joints; 0 without any         | rad or m       |              |
    | tool        | pose of the tool by these readings, wxyz_xyz in W            | m              | 7            |
    | goal        | goal configuration                                           | rad or m       | nq           |
    | tool_goal   | goal pose of the tool, wxyz_xyz in W                         | m              | 7            |
    | objects     | positions of the entities in W, in the order of the scene    | m              | entity xyz   |
    | q_desired   | current target positions of the low-level controller         | rad or m       | nq           |
    | qd_desired  | target velocities of the low-level controller, last period   | rad/s or m/s   | nq           |
    | images      | pictures by camera name                                      |                | height width |
    """

    time: float
    q: Float[Array, " nq"]
    qd: Float[Array, " nq"]
    torque: Float[Array, " nq"]
    opening: float
    tool: Float[Array, " 7"]
    goal: Float[Array, " nq"]
    tool_goal: Float[Array, " 7"]
    objects: Float[Array, "entity xyz"]
    q_desired: Float[Array, " nq"]
    qd_desired: Float[Array, " nq"]
    images: Mapping[str, UInt8[Array, "height width 3"]] = field(default_factory=dict)

    @property
    def vector(self) -> Float[Array, " n"]:
        """Positions, speeds, goals and objects in one row; without time, torques, pictures and desired values."""
        return np.concatenate([self.q, self.qd, self.tool, self.goal, self.tool_goal, self.objects.ravel()])


Policy = Callable[[Observation], ArrayLike]
"""A callable that takes an observation and returns an action.

Its attribute `action` names the kind of its actions, see `ACTIONS`; the default is joint positions.
"""

PolicyFactory = Callable[[PolicyTask, int], Policy]
"""Creates a policy for one episode of a task with a seed; state kept between calls is reset."""


@dataclass(frozen=True, eq=False)
class Acting:
    """A function with a kind of actions.

    Args:
        function: Function from observation to action.
        action: One of `ACTIONS`.
    """

    function: Callable[[Observation], ArrayLike]
    action: str = "joint_position"

    def __post_init__(self) -> None:
        check_action(self.action)

    def __call__(self, observation: Observation, /) -> ArrayLike:
        """Return the next action."""
        return self.function(observation)


class PolicyError(GracefulPlanError, RuntimeError):
    """Raised for a policy that cannot be found or that violates the interface.

    Args:
        name: Name of the policy.
        problem: The violation.
    """

    def __init__(self, name: str, problem: str) -> None:
        self.name, self.problem = name, problem
        super().__init__(f"policy {name}: {problem}")


def check_action(kind: str) -> None:
    """Raise UnknownNameError unless `kind` is a kind of action."""
    if kind not in ACTIONS:
        raise UnknownNameError("action", kind, ACTIONS)


def action_kind(policy: Policy) -> str:
    """Return the kind of a policy's actions."""
    kind = str(getattr(policy, "action", "joint_position"))
    check_action(kind)
    return kind


def action_size(task: PolicyTask, kind: str) -> int:
    """Return the number of values in an action."""
    return {"tool_pose": 7, "command": task.world.model.nu, "brake": 0}.get(kind, len(task.start))


def checked_action(action: ArrayLike, task: PolicyTask, kind: str) -> Float[Array, " n"]:
    """Return an action as an array.

    Raises:
        PolicyError: If the action has the wrong shape, or is not finite.
    """
    try:
        found = real_array("action", action)
    except (TypeError, ValueError) as error:
        raise PolicyError("of the user", f"its action is not an array of numbers: {error}") from error
    size = action_size(task, kind)
    if found.shape != (size,):
        raise PolicyError("of the user", f"its action has shape {found.shape}, a {kind} has ({size},)")
    if not np.isfinite(found).all():
        raise PolicyError("of the user", f"its action is not finite: {found}")
    return found


def imported_policy(name: str) -> PolicyFactory:
    """Import a policy's factory.

    Args:
        name: "package.module:factory". The module is found like any Python module, or in the current directory. The
            factory is called with a `PolicyTask` and a seed for each episode, and returns a `Policy`.

    Raises:
        PolicyError: If there is no such module, importing it fails, or the factory is not callable.
        UnknownNameError: If the module has no such name.
        SettingError: If `name` does not have this form.
    """
    module_name, _, attribute = name.partition(":")
    if not module_name or not attribute:
        raise SettingError("policy", name, "package.module:factory")
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)  # last, so that files here do not shadow installed modules
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        raise PolicyError(name, f"importing {module_name} raised {type(error).__name__}: {error}") from error
    factory: Any = getattr(module, attribute, None)
    if factory is None:
        valid = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise UnknownNameError(f"policy of {module_name}", attribute, valid)
    found: PolicyFactory = factory
    if not callable(factory):
        raise PolicyError(name, "is not callable")
    return found

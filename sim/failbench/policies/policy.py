"""The contract of a policy: a callable from what is seen to what is to be done."""

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
from graceful_plan.array_types import Float, UInt8
from graceful_plan.exceptions import SettingError, UnknownNameError

Array = np.ndarray

ACTIONS: Mapping[str, str] = MappingProxyType(
    {
        "joint_position": "where the joints are to be after the period [rad or m]",
        "joint_velocity": "how fast they are to move during it [rad/s or m/s]",
        "tool_pose": "where the tool is to be after it, wxyz_xyz in W",
        "command": "what every actuator gets, as the simulated drives take it",
        "brake": "nothing: the brakes of all joints close for good, and their drives lose their power",
    }
)
"""Kinds of actions, and what is in them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """What a policy sees, broken sensors and delays included. Objects and pictures are seen as they are.

    What is desired is the robot's own affair: no sensor and no delay has a part in it. Actions of the kind "command"
    take the place of the low-level controller, and leave it where it began.

    | field       | meaning                                                      | unit           | shape        |
    |-------------|--------------------------------------------------------------|----------------|--------------|
    | time        | since the beginning of the episode, on the policy's clock    | s              |              |
    | q           | what position sensors read                                   | rad or m       | nq           |
    | qd          | what speed sensors read                                      | rad/s or m/s   | nq           |
    | tool        | pose of the tool by these readings, wxyz_xyz in W            | m              | 7            |
    | goal        | where the joints are to end                                  | rad or m       | nq           |
    | tool_goal   | where the tool is to end, wxyz_xyz in W                      | m              | 7            |
    | objects     | where the entities are in W, in the order of the scene       | m              | entity xyz   |
    | q_desired   | where the low-level controller wants the joints to be now    | rad or m       | nq           |
    | qd_desired  | how fast it wanted them to move in the last period           | rad/s or m/s   | nq           |
    | images      | pictures by camera                                           |                | height width |
    """

    time: float
    q: Float[Array, " nq"]
    qd: Float[Array, " nq"]
    tool: Float[Array, " 7"]
    goal: Float[Array, " nq"]
    tool_goal: Float[Array, " 7"]
    objects: Float[Array, "entity xyz"]
    q_desired: Float[Array, " nq"]
    qd_desired: Float[Array, " nq"]
    images: Mapping[str, UInt8[Array, "height width 3"]] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def vector(self) -> Float[Array, " n"]:
        """Everything but time, pictures and what is desired in one row."""
        return np.concatenate([self.q, self.qd, self.tool, self.goal, self.tool_goal, self.objects.ravel()])


Policy = Callable[[Observation], ArrayLike]
"""Anything that can be called with an observation and returns an action.

An attribute `action`, one of `ACTIONS`, says of which kind its actions are; without it, they are joint positions.
"""

PolicyFactory = Callable[[PolicyTask, int], Policy]
"""Makes a policy for one episode of a task with a seed: what is remembered from call to call begins anew."""


@dataclass(frozen=True, eq=False)
class Acting:
    """A function whose actions are of some kind.

    Args:
        function: From observation to action.
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
    """A policy that cannot be found, or does not do what policies do.

    Args:
        name: Which.
        problem: What is wrong with it.
    """

    def __init__(self, name: str, problem: str) -> None:
        self.name, self.problem = name, problem
        super().__init__(f"policy {name}: {problem}")


def check_action(kind: str) -> None:
    """Raise UnknownNameError unless this is a kind of action."""
    if kind not in ACTIONS:
        raise UnknownNameError("action", kind, ACTIONS)


def action_kind(policy: Policy) -> str:
    """Return of which kind a policy's actions are."""
    kind = str(getattr(policy, "action", "joint_position"))
    check_action(kind)
    return kind


def action_size(task: PolicyTask, kind: str) -> int:
    """Return how many numbers an action has."""
    return {"tool_pose": 7, "command": task.world.model.nu, "brake": 0}.get(kind, len(task.start))


def checked_action(action: ArrayLike, task: PolicyTask, kind: str) -> Float[Array, " n"]:
    """Return an action as an array.

    Raises:
        PolicyError: If it has the wrong shape, or is not finite.
    """
    try:
        found = np.asarray(action, dtype=float)
    except (TypeError, ValueError) as error:
        raise PolicyError("of the user", f"its action is no array of numbers: {error}") from error
    size = action_size(task, kind)
    if found.shape != (size,):
        raise PolicyError("of the user", f"its action has shape {found.shape}, a {kind} has ({size},)")
    if not np.isfinite(found).all():
        raise PolicyError("of the user", f"its action is not finite: {found}")
    return found


def imported_policy(name: str) -> PolicyFactory:
    """Import a policy's factory.

    Args:
        name: "package.module:factory", found as Python finds modules, and in the current directory. It is called with a
            `PolicyTask` and a seed for each episode, and returns a `Policy`.

    Raises:
        PolicyError: If there is no such module, importing it fails, or the factory cannot be called.
        UnknownNameError: If the module has no such name.
        SettingError: If the name is none of that kind.
    """
    module_name, _, attribute = name.partition(":")
    if not module_name or not attribute:
        raise SettingError("policy", name, "package.module:factory")
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)  # last, so that no file here takes the place of a module that is installed
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
        raise PolicyError(name, "is nothing that can be called")
    return found

"""Task of a policy: to bring the tool and its object from a start to a goal in a simulated scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import mujoco
import numpy as np

import graceful_plan as gp
from failbench.rollouts.execution import LONGEST
from failbench.rollouts.healthy_commands import standing
from failbench.rollouts.healthy_run import settled
from failbench.simulated.states import STATE
from failbench.simulated.world import SimSettings, World, build_world
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError
from graceful_plan.path import is_real, is_whole, plain_numbers
from graceful_plan.scene.placement import Placement
from graceful_plan.setting_checks import positive_fraction

_TRIES = 20
"""Number of random starts to try; if all collide, the episode begins at the task's start."""
_REMEMBERED = 64
"""Number of cached settled starts, since episodes with different faults have the same starts."""


def _is_pair(value: object) -> bool:
    return isinstance(value, tuple | list) and len(value) == 2


@dataclass(frozen=True, kw_only=True)
class PolicySettings:
    """Settings of episodes.

    Args:
        period: Time between actions [s].
        limit: Time limit of an episode [s]; None for three times the duration of the straight path, plus `horizon`.
        horizon: Least duration of an episode after the onset of a fault [s].
        noise: Standard deviation of the start around the task's start [rad or m], cut off at two deviations.
        speed: Fraction of the speed limits for commanded joint motions and for timing the straight path.
        reach: Distance [m] and angle [rad] within which the tool is at its goal.
        dwell: Time that the tool must stay at its goal [s].
        cameras: Names of the cameras whose pictures the policy gets.
        size: Height and width of these pictures [pixels].
        simulation: Settings of the simulation.
    """

    period: float = 0.02
    limit: float | None = None
    horizon: float = 1.0
    noise: float = 0.02
    speed: float = 0.5
    reach: tuple[float, float] = (0.02, 0.1)
    dwell: float = 0.1
    cameras: tuple[str, ...] = ()
    size: tuple[int, int] = (96, 96)
    simulation: SimSettings = SimSettings()

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not isinstance(self.simulation, SimSettings):
            raise SettingError("simulation", self.simulation, "SimSettings")
        steps = self.period / self.simulation.timestep if is_real(self.period) and 0.0 < self.period <= LONGEST else 0.0
        if not (1.0 <= round(steps) and abs(steps - round(steps)) < 1e-6):
            raise SettingError("period", self.period, f"a multiple of the time step, {self.simulation.timestep:g} s")
        if self.limit is not None and not (is_real(self.limit) and self.period <= self.limit <= LONGEST):
            raise SettingError("limit", self.limit, f"between the period and {LONGEST:g} s")
        for name, most in (("horizon", LONGEST), ("noise", 10.0), ("dwell", LONGEST)):
            if not (is_real(getattr(self, name)) and 0.0 <= getattr(self, name) <= most):
                raise SettingError(name, getattr(self, name), f"a finite number >= 0, at most {most:g}")
        positive_fraction("speed", self.speed, "0 < speed <= 1")
        if not (_is_pair(self.reach) and all(is_real(x) and math.isfinite(x) and x > 0.0 for x in self.reach)):
            raise SettingError("reach", self.reach, "a distance [m] and an angle [rad], both > 0")
        if not (_is_pair(self.size) and all(is_whole(n) and 1 <= n <= 4096 for n in self.size)):
            raise SettingError("size", self.size, "height and width in pixels, 1 to 4096")
        cameras = self.cameras
        if not isinstance(cameras, tuple | list) or not all(isinstance(name, str) for name in cameras):
            raise SettingError("cameras", cameras, "a tuple of names")

    @property
    def steps(self) -> int:
        """Simulation steps per period."""
        return round(self.period / self.simulation.timestep)


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyTask:
    """A task prepared for policies. Made by `policy_task`.

    Args:
        name: "SCENE/TASK".
        world: The simulated world.
        start: Start configuration [rad or m].
        goal: Goal configuration [rad or m]; of several goals, the one nearest to the start.
        settings: Settings of episodes.
    """

    name: str
    world: World
    start: Float[Array, " nq"]
    goal: Float[Array, " nq"]
    settings: PolicySettings

    @property
    def scene(self) -> gp.Scene:
        """The scene, with the object in the gripper."""
        return self.world.scene

    @cached_property
    def straight(self) -> gp.Trajectory:
        """The straight joint path from start to goal, timed; it may collide."""
        path = gp.Path(np.array([self.start, self.goal]))
        return gp.retime(path, self.scene.limits, self.scene.joints, speed=self.settings.speed)

    @cached_property
    def limit(self) -> float:
        """Time limit of an episode [s]."""
        settings = self.settings
        return 3.0 * self.straight.duration + settings.horizon if settings.limit is None else settings.limit

    @cached_property
    def periods(self) -> int:
        """Number of actions in the longest episode."""
        return max(1, math.ceil(self.limit / self.settings.period - 1e-9))

    @cached_property
    def tool_goal(self) -> Float[Array, " 7"]:
        """Pose of the tool at the goal, wxyz_xyz in W."""
        return tool_pose(self.scene, Placement(self.scene).place(self.goal))

    @cached_property
    def standing(self) -> Float[Array, " actuator"]:
        """Commands of all actuators without an action for the arm; the gripper holds."""
        command = standing(self.world)
        command[self.world.robot.gripper_actuators] = self.world.robot.grip_closed
        return command

    @cached_property
    def at_start(self) -> Float[Array, " state"]:
        """Initial state of episodes without noise."""
        return settled(self.start, self.world, self.standing)

    def begin(self, rng: np.random.Generator) -> tuple[Float[Array, " nq"], Float[Array, " state"]]:
        """Draw the start of an episode: configuration and state."""
        noise, (low, high) = self.settings.noise, self.scene.limits.position.T
        for _ in range(_TRIES if noise else 0):
            shift = noise * np.clip(rng.standard_normal(len(self.start)), -2.0, 2.0)
            q = np.clip(self.start + shift, low, high)
            if float(gp.clearance(q, self.scene)) > 0.0:
                return q, self._settled_at(tuple(q.tolist()))
        return self.start, self.at_start

    @cached_property
    def _settled_at(self) -> Callable[[tuple[float, ...]], Float[Array, " state"]]:
        @lru_cache(maxsize=_REMEMBERED)
        def at(q: tuple[float, ...]) -> Float[Array, " state"]:
            state = settled(np.array(q), self.world, self.standing)
            state.flags.writeable = False
            return state

        return at

    @cached_property
    def places(self) -> Float[Array, "entity xyz"]:
        """Initial positions of the entities, in W [m]."""
        data = mujoco.MjData(self.world.model)
        mujoco.mj_setState(self.world.model, data, self.at_start, STATE)
        mujoco.mj_kinematics(self.world.model, data)
        return data.xpos[[bodies[0] for bodies in self.world.entity_bodies.values()]].copy()


def tool_pose(scene: gp.Scene, data: mujoco.MjData) -> Float[Array, " 7"]:
    """Return the tool's pose, wxyz_xyz in W."""
    site = data.site(scene.tool)
    pose = np.empty(7)
    mujoco.mju_mat2Quat(pose[:4], site.xmat)
    pose[4:] = site.xpos
    return pose


def policy_task(name: str, settings: PolicySettings | None = None) -> PolicyTask:
    """Prepare a scene's task for policies.

    Args:
        name: "SCENE/TASK" of a bundled scene or a scene file; the task may be left out if there is only one.
        settings: Settings of episodes.

    Raises:
        UnknownNameError: If there is no such scene, or it has no such task.
        UnsupportedError: If FailBench cannot simulate it, the scene has moving entities, or its robot drives.
    """
    settings = PolicySettings() if settings is None else settings
    if not isinstance(name, str):
        raise UnknownNameError("scene", repr(name), gp.scenes())
    whole = name in gp.scenes() or name.endswith((".yaml", ".xml"))
    scene_name, task_name = (name, "") if whole else (name.rpartition("/")[0], name.rpartition("/")[2])
    tasks = gp.load_scene(scene_name or name).tasks
    task_name = task_name or (next(iter(tasks)) if len(tasks) == 1 else "")
    if task_name not in tasks:
        raise UnknownNameError(f"task of {scene_name}", task_name, tasks)
    task = tasks[task_name]
    if task.scene.base is not None or task.scene.moving:
        what = "its robot drives" if task.scene.base is not None else "it has moving entities"
        raise UnsupportedError(f"{name}: policies act on fixed arms in scenes without moving entities; {what}")
    far = np.abs(task.goal - task.start).max(axis=1)
    return PolicyTask(
        name=f"{scene_name}/{task_name}",
        world=build_world(task.scene, settings.simulation),
        start=np.array(task.start),
        goal=np.array(task.goal[int(far.argmin())]),
        settings=settings,
    )

"""The healthy execution of a trajectory, from which failures start and with which they are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike

from failbench.basics.errors import ExecutionRefused
from failbench.recording.healthy import HealthyHarm, HealthySteps, healthy_harm
from failbench.rollouts.driven import TICK, WheelPlan, wheel_plan
from failbench.rollouts.healthy_checks import (
    check_range,
    check_tracking,
    displacement,
    is_allowed,
    touched_pairs,
    why_lost,
)
from failbench.rollouts.healthy_commands import joint_commands, motion_commands
from failbench.rollouts.healthy_run import HealthyRun, drive, joined, settled, simulate
from failbench.rollouts.healthy_touches import HealthyTouches
from failbench.rollouts.stops_ahead import StopsAhead
from failbench.simulated.moving_entities import EntityPoses
from failbench.simulated.rolling import PLANAR
from failbench.simulated.states import CHECKPOINT, put, warnings_counted_only
from failbench.simulated.stiction import SURFACE, Stiction
from failbench.simulated.world import World
from graceful_plan import Path, PlanResult, Trajectory, retime
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import real_array

LONGEST = 200.0
"""Longest motion and horizon [s]; states and commands of all steps are kept in memory."""
_TRACKING = 0.05
"""Tracking error above which a joint counts as not following [rad or m]."""
_SLIP = 0.02
"""Displacement in the tool frame above which an object counts as lost [m]."""
_DRAWS = 50
"""Largest number of times that deviations of moving entities are drawn again; then they follow their predictions."""
_FALL = 1.0
"""Simulated time after a healthy run loses its object [s], equal to the default horizon of rollouts."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Execution:
    """A trajectory executed by a healthy robot. Made by `execute`.

    | field          | meaning                                                                    | shape            |
    |----------------|----------------------------------------------------------------------------|------------------|
    | world          | the simulated world                                                        |                  |
    | trajectory     | the executed trajectory                                                    |                  |
    | states         | MuJoCo's integration state at each checkpoint                              | checkpoint state |
    | command        | commands of all actuators; the last is held after the end                  | step actuator    |
    | measured       | positions and velocities of the joints before each step and after the last | step 2 driven    |
    | baseline       | components and entities that touch without a failure                       |                  |
    | tracking_error | greatest tracking error of each joint [rad or m]                           | nq               |
    | slip           | greatest displacement of the carried object in the tool frame [m]          |                  |
    | healthy        | spills and hits without a failure                                          |                  |
    | base           | the motion that a driving base follows; None if the robot does not drive   |                  |
    | loop           | target angles of the wheel servos at each tick, and the loop's integral    | tick wheel+1     |
    """

    world: World
    trajectory: Trajectory
    states: Float[Array, "checkpoint state"]
    command: Float[Array, "step actuator"]
    measured: Float[Array, "state_and_step 2 driven"]
    baseline: frozenset[tuple[str, str]]
    tracking_error: Float[Array, " nq"]
    slip: float
    healthy: HealthyHarm
    base: WheelPlan | None = None
    loop: Float[Array, "tick wheel_and_1"] | None = None

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self.world.settings.timestep

    @property
    def duration(self) -> float:
        """Duration of the trajectory [s]."""
        return self.trajectory.duration

    def checkpoint(self, onset: float) -> int:
        """Return the checkpoint nearest to a time after the start of the trajectory [s]."""
        nearest = round(onset / (CHECKPOINT * self.dt))
        return min(max(nearest, 0), len(self.states) - 1)

    def steps(self, horizon: float) -> int:
        """Return the number of time steps in a horizon [s].

        Raises:
            SettingError: If the horizon is shorter than a time step or longer than `LONGEST`.
        """
        if not self.dt <= horizon <= LONGEST:
            raise SettingError("horizon", horizon, f"between the time step of {self.dt:g} s and {LONGEST:g} s")
        return round(horizon / self.dt)

    def paced(
        self, time: Float[Array, " n"], pace: Float[Array, " n"], change: Float[Array, " n"]
    ) -> Float[Array, "n driven"]:
        """Return the healthy controller's joint commands for the trajectory at another pace.

        Args:
            time: Time on the trajectory's clock [s].
            pace: Rate of that clock; 1 is as planned.
            change: Rate of change of the pace [1/s].
        """
        trajectory, rate = self.trajectory, pace[:, None]
        q, qd, qdd = trajectory.at(trajectory.t[0] + np.clip(time, 0.0, trajectory.duration))
        return joint_commands(self.world, q, qd * rate, qdd * rate**2 + qd * change[:, None])

    def stopped(self, every: float, onset: float, time: Float[Array, " n"]) -> Float[Array, "n driven"]:
        """Return the healthy controller's joint commands for the next stop planned ahead after an onset.

        Args:
            every: Time between the beginnings of two stops [s].
            onset: Time after the start of the trajectory [s].
            time: Times after the onset [s].
        """
        trajectory, now = self.trajectory, float(self.trajectory.t[0]) + onset
        braked = trajectory.spliced(self._stops.every(every).after(now))
        return joint_commands(self.world, *braked.at(now + time))

    @cached_property
    def _stops(self) -> StopsAhead:
        return StopsAhead(self.trajectory, self.world.scene)

    def planned(self, time: Float[Array, " n"]) -> Float[Array, "n nq"]:
        """Return the planned joint positions at times after the start of the trajectory [s]."""
        trajectory = self.trajectory
        return trajectory.at(trajectory.t[0] + np.clip(time, 0.0, trajectory.duration)).q

    def walk(self, step: int, count: int, seed: int) -> Float[Array, "step_and_next mocap"]:
        """Return the poses of moving entities before each of `count` steps from `step` on, and after the last.

        Deviations from the prediction with which an entity would touch the healthy robot, too, are drawn again: such a
        touch is no consequence of the failure.

        Args:
            step: First step, at which the robot fails.
            count: Number of steps.
            seed: Seed of the deviations.
        """
        model, walkers = self.world.model, self.world.walkers
        if not model.nmocap:
            return np.zeros((count + 1, 0))
        rng, time = np.random.default_rng([seed, 1]), self.trajectory.t[0] + self.dt * np.arange(step, step + count + 1)
        walk = EntityPoses(model, walkers, rng)
        rows, varies = walk.rows(time), any(walker.spread > 0.0 or walker.growth > 0.0 for walker in walkers)
        for left in reversed(range(_DRAWS)):
            if not varies or not self._touches.any(rows, step):
                break
            walk = EntityPoses(model, walkers, rng if left else None)
            rows = walk.rows(time)
        return walk.reacted(rows, self.dt, self.world.settings.people, self.states_tool(step))

    @cached_property
    def _touches(self) -> HealthyTouches:
        return HealthyTouches(self.world, self.states, self.baseline)

    def states_tool(self, step: int) -> Float[Array, " 3"]:
        """Return the planned tool position before a step, in W [m]."""
        q = self.planned(np.array([step * self.dt]))[0]
        scene = self.world.scene
        return scene.data_at(q).site_xpos[int(scene.model.site(scene.tool).id)].copy()

    def commands(self, step: int, count: int) -> Float[Array, "count actuator"]:
        """Return a copy of the commands of `count` steps from `step` on; the last command is held after the end."""
        return self.command[np.minimum(np.arange(step, step + count), len(self.command) - 1)]


class ObjectLost(ExecutionRefused):
    """Raised for a motion along which the object slips out of the healthy gripper.

    Args:
        what: The object.
        time: Time of the loss, on the trajectory's clock [s].
        problem: Displacement of the object, and the remedy.
        healthy: Hits that follow from the loss, with probability 1.
    """

    def __init__(self, what: str, time: float, problem: str, healthy: HealthyHarm) -> None:
        self.healthy = healthy
        super().__init__(what, time, f"{problem}; {healthy}" if str(healthy) else problem)


def as_trajectory(motion: Trajectory | Path | PlanResult | ArrayLike, world: World) -> Trajectory:
    """Return a motion as a trajectory: paths and arrays of configurations are timed within the scene's limits.

    Raises:
        PlanningFailed: If the motion is the result of a failed plan.
        SettingError: If the trajectory has other joints than the scene or another order of them, or is too long.
    """
    if isinstance(motion, PlanResult):
        motion = motion.unwrap()
    if not isinstance(motion, Trajectory):
        path = motion if isinstance(motion, Path) else Path(real_array("motion", motion))
        motion = retime(path, world.scene.limits, world.scene.joints)
    if motion.duration > LONGEST:
        raise SettingError("duration of the trajectory", motion.duration, f"at most {LONGEST:g} s")
    if motion.joints != world.scene.joints:
        raise SettingError("joints of the trajectory", motion.joints, f"those of the scene: {world.scene.joints}")
    return motion


def execute(
    motion: Trajectory | Path | PlanResult | ArrayLike,
    world: World,
    *,
    tolerance: float = _TRACKING,
    controller: object = None,
) -> Execution:
    """Execute a motion with a healthy robot.

    Args:
        motion: A trajectory; anything else is timed first.
        world: The simulated world.
        tolerance: Greatest tracking error of a joint [rad or m].
        controller: Controller of a driving base; `fitted_tracking` by default. A controller without a time law, a
            `PurePursuit` or a `DynamicWindow`, follows the motion's path at its own pace while the arm moves in time.
            The execution's trajectory is then the driven one.

    Raises:
        ExecutionRefused: If a joint does not follow or would leave its range, or a base does not arrive.
        ObjectLost: If the object leaves the gripper; the error holds the harm that this does.
        SettingError: If a controller is given for a robot that does not drive.
    """
    trajectory = as_trajectory(motion, world)
    dt = world.settings.timestep
    base = wheel_plan(world, trajectory, controller)
    free = base is not None and not base.in_time
    whole = trajectory.duration if base is None or not free else min(base.seconds, LONGEST)
    steps = max(1, int(np.ceil(whole / dt - 1e-9)))
    wanted = trajectory.at(trajectory.t[0] + np.minimum(np.arange(1, steps + 1) * dt, trajectory.duration)).q
    check_range(wanted, tolerance, world, dt)
    command = motion_commands(trajectory, world, steps)
    loop = None
    with warnings_counted_only():
        start = settled(trajectory.q[0], world, command[0], time=float(trajectory.t[0]))
        batch = Batch(world.model, 1, nthread=1, persistent=True)
        put(batch, np.array([0]), start[None])
        stiction = Stiction(world, batch, batch.expand(SURFACE))
        if base is None:
            run = simulate(world, batch, command[:steps], start[None], stiction)
        else:
            run, loop = drive(world, batch, command, start[None], stiction, base)
        steps = len(run.qpos)
        command = command[: steps + 1]
        error = np.abs(run.qpos[:, _planned(world)] - wanted[:steps])
        if free:
            error[:, :PLANAR] = 0.0
            trajectory = _as_driven(world, trajectory, run, dt)
        check_tracking(error, tolerance, world, dt)
        slip = displacement(run.xpos, run.xquat, world)
        stays = slip <= _SLIP
        lost = None if stays.all() else int(stays.argmin())
        if lost is not None:
            fall = np.repeat(command[-1:], round(_FALL / dt), axis=0)
            run = joined([run, simulate(world, batch, fall, run.states[-1:], stiction)])
    healthy = _healthy(world, run, lost)
    if lost is not None:
        problem = why_lost(world, start, float(slip[lost]))
        raise ObjectLost(f"the object {world.model.body(world.carried_body).name!r}", (lost + 1) * dt, problem, healthy)
    states = run.states[::CHECKPOINT].copy()
    measured = _measured(world, run.states)
    states.flags.writeable = command.flags.writeable = measured.flags.writeable = False
    return Execution(
        world=world,
        trajectory=trajectory,
        states=states,
        command=command,
        measured=measured,
        baseline=touched_pairs(world, run.sensordata),
        tracking_error=error.max(axis=0),
        slip=float(slip.max()),
        healthy=healthy,
        base=base,
        loop=loop,
    )


def _planned(world: World) -> Array:
    """Return the addresses in qpos of the planned joints."""
    return world.robot.qpos if world.rolling is None else world.rolling.planned


def _as_driven(world: World, planned: Trajectory, run: HealthyRun, dt: float) -> Trajectory:
    """Return the driven motion of a base whose controller followed the path at its own pace."""
    rows = np.unique([*range(0, len(run.qpos), TICK), len(run.qpos) - 1])
    q = run.qpos[rows][:, _planned(world)]
    t = planned.t[0] + (rows + 1) * dt
    qd = np.gradient(q, t, axis=0) if len(q) > 1 else np.zeros_like(q)
    qdd = np.gradient(qd, t, axis=0) if len(q) > 1 else np.zeros_like(q)
    return Trajectory(t - dt, q, qd, qdd, planned.joints)


def _measured(world: World, states: Float[Array, "n state"]) -> Float[Array, "n 2 driven"]:
    """Return positions and velocities of the driven joints in MuJoCo states, which begin with the time."""
    robot, nq = world.robot, world.model.nq
    return np.stack([states[:, 1 + robot.qpos], states[:, 1 + nq + robot.dofs]], axis=1)


def _healthy(world: World, run: HealthyRun, lost: int | None) -> HealthyHarm:
    """Compute the harm of a run in which the object is lost at step `lost`, or not at all (None).

    Touches at the beginning are left out, and so are touches that the scene allows while the object is held.
    """
    at_first, held = touched_pairs(world, run.sensordata[:1]), touched_pairs(world, run.sensordata[:lost])
    allowed = at_first | {pair for pair in held - at_first if is_allowed(world, *pair)}
    steps = HealthySteps(run.sensordata, run.states)
    return healthy_harm(world, steps, touched=lost is not None or bool(held - allowed), allowed=allowed)

"""One episode: observations, actions, faults, and consequences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from failbench.fault.drives import BRAKES, close_brakes
from failbench.policies.policy import Observation, checked_action
from failbench.policies.sensing import Reading, Sensing
from failbench.policies.servoing import Servoing, Straightness
from failbench.policies.task import PolicyTask, tool_pose
from failbench.recording.recorder import Recorder
from failbench.recording.records import RolloutRequest
from failbench.rollouts.injection import NEVER, Injection
from failbench.simulated.rest import PERIOD
from failbench.simulated.states import CHECKPOINT, STATE
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float, UInt8
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.placement import Placement

Camera = Callable[[Array], Mapping[str, UInt8[Array, "height width 3"]]]
"""Takes pictures for positions of the whole model."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Live:
    """Live arrays of one simulation.

    Args:
        fields: Returns a field of its model by name.
        qpos: Positions of the whole model.
        qvel: Velocities of the whole model.
        eq_active: Which constraints are active.
        force: Torques and forces of all actuators in the last step.
    """

    fields: Callable[[str], Array]
    qpos: Array
    qvel: Array
    eq_active: Array
    force: Array


class _Seen(NamedTuple):
    """Readings at the end of a period, from which observations are made."""

    step: int
    reading: Reading
    torque: Float[Array, " nq"]
    qpos: Float[Array, " qpos"]


class Sent:
    """Commands that a policy has sent up to now, in place of an `Execution`: the last command is held.

    Later commands are not known, and the robot must not be a driving base.
    """

    base = None
    loop = None

    def __init__(self, task: PolicyTask) -> None:
        self.world: World = task.world
        self.measured = np.zeros((0, 2, len(task.start)))
        self.dt = task.world.settings.timestep
        self.command = np.tile(task.standing, (task.periods * task.settings.steps, 1))
        self.straight_on: Straightness | None = None
        """Motion of the joints at the onset, continued straight on."""

    def checkpoint(self, onset: float) -> int:
        """Return the checkpoint nearest to a time [s]."""
        return min(max(round(onset / (CHECKPOINT * self.dt)), 0), (len(self.command) - 1) // CHECKPOINT)

    def commands(self, step: int, count: int) -> Array:
        """Return a view of the commands from a step on; later commands appear in it."""
        return self.command[step : step + count]

    def planned(self, time: Array) -> Array:
        """Return NaN: the future motion of a policy is not known."""
        return np.full((len(time), self.measured.shape[-1]), np.nan)

    def walk(self, step: int, count: int, seed: int) -> Array:
        """Return no poses: policies have no moving entities."""
        return np.zeros((count + 1, 0))

    def paced(self, time: Array, pace: Array, change: Array) -> Array:
        """Return joint commands for the straight motion from the onset on, at another pace."""
        assert self.straight_on is not None
        return self.straight_on.commands(time, pace)

    def stopped(self, every: float, onset: float, time: Array) -> Array:
        """Refuse stops planned ahead: the future motion of a policy is not known."""
        raise UnsupportedError(
            "a policy has no planned motion to stop along: leave out prepared=, or use the recovery PreparedStop"
        )


class Episode:
    """One episode in one simulation. The code that steps the simulation calls `act`, `commands` and `after`.

    Args:
        task: The task.
        servoing: The low-level controller, at the episode's beginning.
        job: The fault and its onset; None for no fault.
        live: The simulation, at the episode's beginning.
        camera: Takes pictures for policies that use them.
    """

    def __init__(
        self, task: PolicyTask, servoing: Servoing, job: RolloutRequest | None, live: Live, camera: Camera | None
    ) -> None:
        self.task, self.job, self.step = task, job, 0
        self._servoing, self._live, self._camera = servoing, live, camera
        self._sent = Sent(task)
        self.onset = NEVER if job is None else self._sent.checkpoint(job.onset) * CHECKPOINT
        """Step of the onset."""
        self._injection: Injection | None = None
        self._sensing: Sensing | None = None
        self._placement = Placement(task.scene)
        qpos, qvel = live.qpos.copy(), live.qvel.copy()
        self._recorder = Recorder(task.world, _allowed(task, qpos, qvel), qpos[None], qvel[None])
        robot = task.world.robot
        self._seen: list[_Seen] = []
        self._fingers = task.world.model.jnt_qposadr[robot.gripper_joints].astype(int)
        self._there = 0
        self._brakes: dict[str, Array] = {}
        self.reached: float | None = None
        """Time at which the tool had been at its goal for the dwell time [s]; None before."""
        self.distance = self._distance(qpos[robot.qpos])
        """Distance of the tool from its goal [m and rad]."""
        self._see()

    @property
    def time(self) -> float:
        """Time since the beginning [s]."""
        return self.step * self._sent.dt

    @property
    def qpos(self) -> Float[Array, " qpos"]:
        """Current positions of the whole model; a live array."""
        return self._live.qpos

    @property
    def over(self) -> bool:
        """Whether the episode can end: the goal is reached, and the horizon after the onset has passed."""
        horizon = round(self.task.settings.horizon / self._sent.dt)
        broken = self.onset == NEVER or self.step >= self.onset + horizon
        return self.timed_out or (self.reached is not None and broken)

    @property
    def timed_out(self) -> bool:
        """Whether the time limit has passed."""
        return self.step >= len(self._sent.command)

    @property
    def observation(self) -> Observation:
        """Current observation of the policy."""
        delay = 0.0 if self._sensing is None else self._sensing.delay
        seen = self._seen[-1]
        if delay > 0.0:
            known = [old for old in self._seen if old.step <= self.step - round(delay / self._sent.dt)]
            seen = (known or self._seen)[-1 if known else 0]
        task, (q, qd), qpos = self.task, seen.reading, seen.qpos
        return Observation(
            time=self.time,  # the policy's clock is not delayed
            q=q,
            qd=qd,
            torque=seen.torque,
            opening=float(qpos[self._fingers].mean()) if len(self._fingers) else 0.0,
            tool=tool_pose(task.scene, self._placement.place(q)),
            goal=task.goal,
            tool_goal=task.tool_goal,
            objects=self._objects(qpos),
            q_desired=self._servoing.q,
            qd_desired=self._servoing.speed,
            images={} if self._camera is None else self._camera(qpos),
        )

    def order(self, kind: str, action: ArrayLike) -> None:
        """Apply the action of the period that begins.

        Raises:
            PolicyError: If the action has the wrong shape, or is not finite.
        """
        rows = self._servoing.commands(kind, checked_action(action, self.task, kind))
        self._sent.command[self.step : self.step + len(rows)] = rows
        self._sent.command[self.step + len(rows) :] = rows[-1]  # held unless overwritten later
        if kind == "brake" and not self._brakes:
            self._brake()
        if self._injection is not None and self.step - self.onset != self._injection.next:
            self._injection.renew()

    def act(self) -> None:
        """Begin, apply or end the fault before this step, if it is due."""
        if self.step == self.onset and self._injection is None and self.job is not None:
            live, steps = self._live, len(self._sent.command) - self.onset
            self._sent.straight_on = self._servoing.straight_on(self.step % self.task.settings.steps)
            self._injection = Injection(
                self._sent,
                self.job,
                steps,
                fields={name: live.fields(name) for name in self.job.fault.FIELDS},
                qpos=live.qpos,
                qvel=live.qvel,
                eq_active=live.eq_active,
            )
            self._injection.brakes = self._brakes
            self._sensing = Sensing(self._injection)
        if self._injection is not None and self._sensing is not None:
            if self.step - self.onset == self._injection.next:
                self._injection.act()
                self._sensing.look()

    @property
    def until_event(self) -> int:
        """Steps until the fault acts next, or the carried object's sleep is checked."""
        origin = self.onset if self._injection is not None else 0
        to_act = self.onset - self.step if self._injection is None else self.onset + self._injection.next - self.step
        return min(to_act, PERIOD - (self.step - origin) % PERIOD)

    @property
    def looks_for_sleep(self) -> bool:
        """Whether the carried object's sleep is to be checked now."""
        origin = self.onset if self._injection is not None else 0
        return (self.step - origin) % PERIOD == 0

    def commands(self, count: int) -> Float[Array, "step actuator"]:
        """Return the drives' commands for the next steps."""
        if self._injection is None:
            return self._sent.command[self.step : self.step + count]
        return self._injection.plant.command[self.step - self.onset : self.step - self.onset + count]

    def after(
        self,
        sensordata: Float[Array, "step sensordata"],
        qpos: Float[Array, "step qpos"],
        qvel: Float[Array, "step qvel"],
    ) -> None:
        """Process simulated steps."""
        self._recorder.observe(sensordata[None], qpos[None], qvel[None])
        self.step += len(qpos)

    def end_period(self) -> None:
        """Update observation and distance to the goal at the end of a period."""
        self._see()
        near, turned = self.distance = self._distance(self._live.qpos[self.task.world.robot.qpos])
        settings = self.task.settings
        self._there = self._there + 1 if near <= settings.reach[0] and turned <= settings.reach[1] else 0
        if self._there * settings.period >= settings.dwell - 1e-9 and self._there:
            self.reached = self.time if self.reached is None else self.reached
        elif not self._there:
            self.reached = None  # the tool has left the goal again

    def finish(self) -> dict[str, Any]:
        """Return the consequences, as fields of a Rollout."""
        return self._recorder.finish(0)

    def _brake(self) -> None:
        """Close the brakes: once if nothing has failed yet, otherwise after each action of the fault."""
        self._brakes = {name: self._live.fields(name) for name in BRAKES}
        if self._injection is None:
            close_brakes(self._brakes, self.task.world)
        else:
            self._injection.brakes = self._brakes

    def _see(self) -> None:
        robot, live = self.task.world.robot, self._live
        if self._sensing is None:
            reading = live.qpos[robot.qpos], live.qvel[robot.dofs]
        else:
            reading = self._sensing.read(self.step - self.onset)
        # The simulation knows no torques before its first step.
        torque = live.force[robot.actuators] if self.step else np.full(len(robot.joints), np.nan)
        self._seen.append(_Seen(self.step, reading, torque, live.qpos.copy()))

    def _distance(self, q: Float[Array, " nq"]) -> tuple[float, float]:
        """Return the distance of the tool from its goal [m and rad]."""
        pose, goal = tool_pose(self.task.scene, self._placement.place(q)), self.task.tool_goal
        turned = 2.0 * np.arccos(min(1.0, abs(float(pose[:4] @ goal[:4]))))
        return float(np.linalg.norm(pose[4:] - goal[4:])), float(turned)

    def _objects(self, qpos: Float[Array, " qpos"]) -> Float[Array, "entity xyz"]:
        """Return the positions of the entities; entities that cannot move freely keep their initial ones."""
        world, places = self.task.world, self.task.places.copy()
        for i, name in enumerate(world.entity_bodies):
            if name in world.movable:
                adr = int(world.model.jnt_qposadr[world.model.body_jntadr[world.movable[name]]])
                places[i] = qpos[adr : adr + 3]
        return places


def _allowed(task: PolicyTask, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"]) -> frozenset[tuple[str, str]]:
    """Return the pairs of component and entity that touch at the beginning or that the scene allows to touch."""
    world, scene = task.world, task.scene
    data = mujoco.MjData(world.model)
    mujoco.mj_setState(world.model, data, task.at_start, STATE)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(world.model, data)
    felt = data.sensordata[world.sensor_adr] > 0.0
    known = scene.allowed_pairs("always") | scene.allowed_pairs("ends")

    def allowed(component: str, entity: str) -> bool:
        own, other = scene.components[component].geoms, scene.entities[entity].geoms
        return any((min(a, b), max(a, b)) in known for a in own for b in other)

    return frozenset(pair for pair, touches in zip(world.pairs, felt, strict=True) if touches or allowed(*pair))

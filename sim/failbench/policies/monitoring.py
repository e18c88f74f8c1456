"""A monitor in the loop of a policy, with imperfect sensors and a robot that differs from its model."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

import graceful_plan as gp
from failbench.policies.adapters import OpenLoop
from failbench.policies.policy import Acting, Observation, Policy, PolicyError, PolicyFactory
from failbench.policies.recovery import Recovering, Recovery
from failbench.policies.rollouts import roll_out
from failbench.policies.task import PolicyTask
from failbench.simulated.world import World
from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real, plain_numbers
from graceful_plan.setting_checks import not_negative

_VARIED = ("body_mass", "body_inertia", "dof_damping", "dof_frictionloss", "geom_friction")
"""Fields of the robot and the carried object that differ from their model."""


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Errors of the readings that a monitor gets from a healthy robot.

    The values are assumptions: those of an arm with encoders of 15 bits, torques from motor currents, and a bus that
    shares its time.

    Args:
        position: Standard deviation of position readings [rad or m].
        speed: Standard deviation of speed readings [rad/s or m/s].
        torque: Standard deviation of torque readings [N m or N].
        opening: Standard deviation of the gripper's opening [m].
        jitter: Greatest error of a sample's time stamp [s].
        delay: Time between a sample and its arrival, a whole number of periods [s].
        lost: Probability that a sample is lost.
    """

    position: float = 2e-4
    speed: float = 5e-3
    torque: float = 0.3
    opening: float = 2e-4
    jitter: float = 1e-3
    delay: float = 0.02
    lost: float = 5e-3

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name, value in vars(self).items():
            not_negative(name, value)
        if not self.lost < 1.0:
            raise SettingError("lost", self.lost, "a probability < 1")


@dataclass(frozen=True, kw_only=True)
class Watch:
    """A monitor with given limits and sensors.

    Args:
        limits: Limits from healthy runs, see `healthy_records`.
        sensors: Errors of its readings.
    """

    limits: gp.MonitorLimits
    sensors: SensorErrors = SensorErrors()


def varied_task(task: PolicyTask, seed: int, share: float = 0.2) -> PolicyTask:
    """Return a task whose simulated robot differs from the scene that planner, controller and monitor know.

    Masses, inertias and frictions of each body of the robot and the carried object are multiplied by factors that are
    uniform in 1 - share to 1 + share.

    Args:
        task: The task.
        seed: Seed of the factors.
        share: Greatest relative difference.

    Raises:
        SettingError: If `share` is not between 0 and 1.
    """
    if not (is_real(share) and 0.0 <= share < 1.0):
        raise SettingError("share", share, "0 <= share < 1")
    return replace(task, world=replace(task.world, model=_varied_model(task.world, seed, share)))


def _varied_model(world: World, seed: int, share: float) -> mujoco.MjModel:
    model, rng = copy.copy(world.model), np.random.default_rng([seed, 2])
    bodies = sorted({body for group in world.striker_bodies.values() for body in group} | world.scene.robot_bodies)
    of_body = np.ones((len(_VARIED), model.nbody))
    of_body[:, bodies] = rng.uniform(1.0 - share, 1.0 + share, (len(_VARIED), len(bodies)))
    of_body[1] = of_body[0]  # the inertia belongs to the mass
    for name, factors in zip(_VARIED, of_body, strict=True):
        values = getattr(model, name)
        owner = {"body": np.arange(model.nbody), "dof": model.dof_bodyid, "geom": model.geom_bodyid}[name.split("_")[0]]
        values *= factors[owner].reshape(-1, *[1] * (values.ndim - 1))
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


_Sample = tuple[float, Array, Array, Array, float]
"""Time, positions, speeds, torques and opening."""


class _Sensors:
    """Readings of one episode as they arrive: with errors, late, and sometimes not at all."""

    def __init__(self, errors: SensorErrors, period: float, seed: int) -> None:
        self._errors, self._rng = errors, np.random.default_rng([seed, 3])
        self._waiting: deque[_Sample | None] = deque([None] * round(errors.delay / period))

    def read(self, seen: Observation) -> _Sample | None:
        """Return the sample that arrives now; None if it is lost."""
        e, rng, n = self._errors, self._rng, len(seen.q)
        sample = (
            seen.time + e.jitter * float(rng.uniform(-1.0, 1.0)),
            seen.q + e.position * rng.standard_normal(n),
            seen.qd + e.speed * rng.standard_normal(n),
            seen.torque + e.torque * rng.standard_normal(n),
            seen.opening + e.opening * float(rng.standard_normal()),
        )
        self._waiting.append(None if rng.random() < e.lost else sample)
        return self._waiting.popleft()


class _Watcher:
    """The monitor of one episode."""

    def __init__(self, task: PolicyTask, motion: gp.Trajectory, watch: Watch, seed: int) -> None:
        self._start = float(motion.t[0])
        self._sensors = _Sensors(watch.sensors, task.settings.period, seed)
        self._monitor = gp.Monitor(motion, task.scene, watch.limits)

    @property
    def notice(self) -> gp.Notice | None:
        return self._monitor.notice

    def __call__(self, seen: Observation) -> bool:
        sample = self._sensors.read(seen)
        if sample is None:
            return self._monitor.update(self._start + seen.time, None) is not None
        time, q, qd, torque, opening = sample
        return self._monitor.update(self._start + time, q, qd, torque, opening) is not None


class _Monitored(Recovering):
    def __init__(self, task: PolicyTask, policy: Policy, recovery: Recovery, watcher: _Watcher, seed: int) -> None:
        super().__init__(task, policy, recovery, watcher, seed)
        self._watcher = watcher

    @property
    def notice(self) -> gp.Notice | None:
        return self._watcher.notice


def monitored(factory: PolicyFactory, recovery: Recovery, watch: Watch) -> PolicyFactory:
    """Return a policy that a recovery replaces once a monitor notices something. It must follow a planned motion."""

    def make(task: PolicyTask, seed: int) -> Policy:
        policy = factory(task, seed)
        return _Monitored(task, policy, recovery, _Watcher(task, _motion(policy), watch, seed), seed)

    return make


def _motion(policy: Policy) -> gp.Trajectory:
    if not isinstance(policy, OpenLoop):
        raise PolicyError("of the user", "does not follow a planned motion, which a monitor compares readings with")
    return policy.motion


def healthy_records(
    task: PolicyTask, factory: PolicyFactory, seeds: Sequence[int], *, sensors: SensorErrors | None = None
) -> list[gp.MonitorRecord]:
    """Record healthy episodes of a policy that follows a planned motion, for `MonitorLimits.fit`.

    Args:
        task: The task; see `varied_task` for errors of its model.
        factory: Creates the policy of each episode.
        seeds: Seeds of the episodes.
        sensors: Errors of the readings.

    Raises:
        PolicyError: If the policy does not follow a planned motion.
    """
    errors = SensorErrors() if sensors is None else sensors
    return [_recorded(task, factory, seed, errors) for seed in seeds]


def _recorded(task: PolicyTask, factory: PolicyFactory, seed: int, errors: SensorErrors) -> gp.MonitorRecord:
    rows: list[_Sample] = []
    motions: list[gp.Trajectory] = []

    def make(task: PolicyTask, seed: int) -> Policy:
        policy = factory(task, seed)
        motions.append(_motion(policy))
        readings = _Sensors(errors, task.settings.period, seed)

        def act(seen: Observation) -> Array:
            sample = readings.read(seen)
            if sample is not None:
                rows.append(sample)
            return np.asarray(policy(seen))

        return Acting(act)

    roll_out(task, make, [seed])
    t, q, qd, torque, opening = (np.array(column) for column in zip(*rows, strict=True))
    return gp.MonitorRecord(
        trajectory=motions[0],
        scene=task.scene,
        t=motions[0].t[0] + t,
        q=q,
        qd=qd,
        torque=torque,
        opening=opening,
    )

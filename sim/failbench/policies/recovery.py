"""Recovery after a detected fault: stop, or stop and replan.

`recovering` models detection as perfect but delayed by `delay` after the onset, whatever the fault. Real delays depend
on the monitor, so evaluate several delays, or a monitor: `failbench.policies.monitoring`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

import graceful_plan as gp
from failbench.policies.adapters import OpenLoop
from failbench.policies.policy import Observation, Policy, PolicyError, PolicyFactory, action_kind
from failbench.policies.task import PolicyTask
from graceful_plan import GracefulPlanError
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real, plain_numbers
from graceful_plan.setting_checks import not_negative, positive

Reaction = Callable[[Observation], Float[Array, " nq"] | None]
"""Controller after the detection: returns joint positions, or None to close the brakes."""

Detector = Callable[[Observation], bool]
"""Returns whether a fault is detected, from the present observation."""

_LOOK = 0.2
"""Averaging time for the check whether joints stand at their targets [s]; long enough to average out noise."""


class Recovery(ABC):
    """A recovery strategy: the interface, with frozen settings."""

    @abstractmethod
    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return the controller that takes over.

        Args:
            task: The task.
            seed: Seed of random draws.
        """


class _Braking:
    """Joint targets that brake straight on and together, from the desired positions and velocities.

    Sensor readings are not used: the jump of a broken sensor would look like a large velocity.
    """

    def __init__(self, task: PolicyTask, deceleration: float, seen: Observation) -> None:
        self._period, self._began = task.settings.period, seen.time
        self._q, self._speed = seen.q_desired, seen.qd_desired
        self.duration = float((np.abs(self._speed) / (deceleration * task.scene.limits.acceleration)).max())

    def elapsed(self, seen: Observation) -> float:
        """Return the time since the braking began [s]."""
        return seen.time - self._began

    def at(self, time: float) -> Float[Array, " nq"]:
        """Return the joint targets for a period after `time` since the braking began [s]."""
        braked = min(time + self._period, self.duration)
        left = braked - braked**2 / (2.0 * self.duration) if self.duration > 0.0 else 0.0
        return self._q + self._speed * left


@dataclass(frozen=True, kw_only=True)
class StopOnFailure(Recovery):
    """A protective stop: all joints brake straight on and together, then hold.

    Args:
        deceleration: Deceleration, as a multiple of the motions' acceleration limit.
        brakes: Whether the brakes close at the end of the stop, as in stop category 1 of IEC 60204-1; else the drives
            hold, as in category 2.
    """

    deceleration: float = 1.0
    brakes: bool = True

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive("deceleration", self.deceleration)
        if not isinstance(self.brakes, bool):
            raise SettingError("brakes", self.brakes, "True or False")

    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return the controller of the stop."""
        braking: list[_Braking] = []

        def stop(seen: Observation) -> Float[Array, " nq"] | None:
            if not braking:
                braking.append(_Braking(task, self.deceleration, seen))
            time = braking[0].elapsed(seen)
            return None if self.brakes and time >= braking[0].duration else braking[0].at(time)

        return stop


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedStop(Recovery):
    """A stop along the planned motion that keeps contents and grasp, planned ahead.

    The robot follows the motion up to the beginning of the next stop.

    Args:
        motion: The motion that the policy follows, with the same period and without an initial offset.
        stops: Its stops, see `graceful_plan.PreparedStops`.
        brakes: Whether the brakes close at the end of the stop; else the drives hold.
    """

    motion: gp.Trajectory
    stops: gp.PreparedStops
    brakes: bool = True

    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return the controller of the stop."""
        chosen: list[gp.Trajectory] = []
        period, start = task.settings.period, float(self.motion.t[0])

        def stop(seen: Observation) -> Float[Array, " nq"] | None:
            now = start + seen.time
            if not chosen:
                chosen.append(self.stops.after(now))
            braked = chosen[0]
            if self.brakes and now >= braked.t[-1]:
                return None
            after = now + period
            return (self.motion if after < braked.t[0] else braked).at(min(after, float(braked.t[-1]))).q

        return stop


@dataclass(frozen=True, kw_only=True)
class BrakeOnFailure(Recovery):
    """All brakes close at once and the drives lose their power, as in stop category 0 of IEC 60204-1."""

    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return the controller that brakes."""
        return lambda seen: None


@dataclass(frozen=True, kw_only=True)
class ReplanOnFailure(Recovery):
    """Stop, plan from the stopped configuration, and continue to the goal; the world moves on during planning.

    The motion never begins before `time_limit`, so that episodes do not depend on the speed of the machine. The planner
    does not know the fault, assumes that the object is held, and plans from the target configuration of the stop. The
    brakes close if readings deviate from the stop's target or later from the motion, or if no motion is found.

    Args:
        w: Safety weight; None for the planner's default.
        time_limit: Simulated duration of stop and planning [s]; a longer stop extends it.
        iterations: Iterations of the planner; they make the motion reproducible.
        deceleration: Deceleration of the stop, as for `StopOnFailure`.
        tolerance: Greatest deviation of a joint's mean reading over the last 0.2 s from the stop's target [rad or m].
        following: Greatest deviation on the way to the goal, as a mean over 0.1 s; wider, so that delayed commands do
            not trigger a stop.
    """

    w: float | None = None
    time_limit: float = 0.5
    iterations: int = 300
    deceleration: float = 1.0
    tolerance: float = 0.05
    following: float = 0.25

    def __post_init__(self) -> None:
        plain_numbers(self)
        not_negative("time_limit", self.time_limit, "a finite time >= 0 s")
        for name in ("tolerance", "following"):
            if not (is_real(getattr(self, name)) and getattr(self, name) > 0.0):
                raise SettingError(name, getattr(self, name), "a number > 0")
        StopOnFailure(deceleration=self.deceleration)

    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return the controller of the stop and the motion after it."""
        return _GoingOn(self, task, seed)


class _GoingOn:
    """State of `ReplanOnFailure` in one episode."""

    def __init__(self, settings: ReplanOnFailure, task: PolicyTask, seed: int) -> None:
        self._settings, self._task, self._seed = settings, task, seed
        self._braking: _Braking | None = None
        self._follower: OpenLoop | None = None
        # Readings minus desired positions; their mean is free of noise.
        self._off: deque[Float[Array, " nq"]] = deque(maxlen=max(1, round(_LOOK / task.settings.period)))

    def __call__(self, seen: Observation) -> Float[Array, " nq"] | None:
        settings = self._settings
        if self._braking is None:
            self._braking = _Braking(self._task, settings.deceleration, seen)
        self._off.append(seen.q - seen.q_desired)
        time = self._braking.elapsed(seen)
        waited = time - max(settings.time_limit, self._braking.duration)
        if waited < -1e-9:
            return self._braking.at(time)
        most, since = (settings.tolerance, 0) if self._follower is None else (settings.following, len(self._off) // 2)
        if np.abs(np.mean(list(self._off)[since:], axis=0)).max() > most:
            return None
        if self._follower is None:
            motion = _motion(settings, self._task, tuple(seen.q_desired.tolist()), self._seed)
            if motion is None:
                return None
            self._follower = OpenLoop(motion, self._task.settings.period)
        return self._follower.at(waited, seen.q_desired)


@lru_cache(maxsize=64)
def _motion(recovery: ReplanOnFailure, task: PolicyTask, q: tuple[float, ...], seed: int) -> gp.Trajectory | None:
    """Plan from a configuration to the goal. Cached, since episodes with different faults stop at the same place."""
    low, high = task.scene.limits.position.T
    try:
        found = gp.plan(
            np.clip(q, low, high),
            task.goal,
            task.scene,
            w=recovery.w,
            iterations=recovery.iterations,
            seed=seed,
            speed=task.settings.speed,
        )
    except GracefulPlanError:
        return None  # the stopped configuration is not a valid start
    return found.trajectory if found.status is gp.PlanStatus.SOLVED else None


class Recovering:
    """A policy that a recovery replaces once a fault is detected.

    Args:
        task: The task.
        policy: Policy up to the detection.
        recovery: Recovery strategy from then on.
        detects: Returns whether a fault is detected now; called with each observation up to the detection.
        seed: Seed of the recovery's draws.

    Raises:
        PolicyError: If the policy sends actuator commands, which bypass the low-level controller that recoveries use.
    """

    def __init__(self, task: PolicyTask, policy: Policy, recovery: Recovery, detects: Detector, seed: int) -> None:
        self._task, self._policy, self._recovery, self._detects, self._seed = task, policy, recovery, detects, seed
        self._reaction: Reaction | None = None
        self.action = action_kind(policy)
        if self.action == "command":
            raise PolicyError("of the user", "sends actuator commands; a recovery supports all other kinds of actions")

    def __call__(self, observation: Observation, /) -> ArrayLike:
        """Return the action of the policy, or of the recovery after the detection."""
        if self._reaction is None and self._detects(observation):
            self._reaction = self._recovery.begin(self._task, self._seed)
        if self.action == "brake":
            return np.zeros(0)  # brakes stay closed
        if self._reaction is None:
            action = self._policy(observation)
            self.action = action_kind(self._policy)
            return action
        wanted = self._reaction(observation)
        self.action = "brake" if wanted is None else "joint_position"
        return np.zeros(0) if wanted is None else wanted


def recovering(factory: PolicyFactory, recovery: Recovery, onset: float, delay: float) -> PolicyFactory:
    """Return a policy that a recovery replaces `delay` after `onset` [s]."""
    if not 0.0 <= delay:
        raise SettingError("delay", delay, "a time >= 0 s")

    def make(task: PolicyTask, seed: int) -> Policy:
        return Recovering(task, factory(task, seed), recovery, lambda seen: seen.time >= onset + delay - 1e-9, seed)

    return make

"""What a controller does after it has noticed a fault: nothing, stop, or plan again from where it is.

Noticing is perfect but late: `delay` after the onset, whatever the fault. How soon a fault is noticed in reality
depends on the monitor; ask for several delays.
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
from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real

Array = np.ndarray

Reaction = Callable[[Observation], Float[Array, " nq"] | None]
"""Takes over from the policy: returns joint positions from the moment of noticing on, or None: let the brakes close."""

_LOOK = 0.2
"""How long it is looked whether joints stand where they are to stand [s]: long enough for noise to average out."""


class Recovery(ABC):
    """What is done once a fault has been noticed: a contract, and frozen settings."""

    @abstractmethod
    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return what takes over.

        Args:
            task: What was to be done.
            seed: Of what is drawn.
        """


class _Braking:
    """Joints that brake straight on, together, from where and how fast they were wanted to be.

    What sensors read has no part in it: a reading that jumps would be a speed at which nothing ever moved.
    """

    def __init__(self, task: PolicyTask, deceleration: float, seen: Observation) -> None:
        self._period, self._began = task.settings.period, seen.time
        self._q, self._speed = seen.q_desired, seen.qd_desired
        self.duration = float((np.abs(self._speed) / (deceleration * task.scene.limits.acceleration)).max())

    def elapsed(self, seen: Observation) -> float:
        """Return how long ago it began [s]."""
        return seen.time - self._began

    def at(self, time: float) -> Float[Array, " nq"]:
        """Return where the joints are to be a period after a time since then [s]."""
        braked = min(time + self._period, self.duration)
        left = braked - braked**2 / (2.0 * self.duration) if self.duration > 0.0 else 0.0
        return self._q + self._speed * left


@dataclass(frozen=True, kw_only=True)
class StopOnFailure(Recovery):
    """A protective stop: all joints brake straight ahead, together; then they are held.

    Args:
        deceleration: Over the greatest acceleration that motions have.
        brakes: Whether brakes close once the joints are to stand, as in a stop of category 1 of IEC 60204-1; else the
            drives hold, as in category 2.
    """

    deceleration: float = 1.0
    brakes: bool = True

    def __post_init__(self) -> None:
        if not (is_real(self.deceleration) and 0.0 < self.deceleration < np.inf):
            raise SettingError("deceleration", self.deceleration, "a finite number > 0")
        if not isinstance(self.brakes, bool):
            raise SettingError("brakes", self.brakes, "True or False")

    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return the stop."""
        braking: list[_Braking] = []

        def stop(seen: Observation) -> Float[Array, " nq"] | None:
            if not braking:
                braking.append(_Braking(task, self.deceleration, seen))
            time = braking[0].elapsed(seen)
            return None if self.brakes and time >= braking[0].duration else braking[0].at(time)

        return stop


@dataclass(frozen=True, kw_only=True)
class ReplanOnFailure(Recovery):
    """Stops, plans from where it stands, and goes on to its goal; the world goes on while it plans.

    A motion that is found sooner is begun no sooner, so that episodes do not depend on how fast the machine is. What is
    broken is not known to the planner, and it takes the object for held. It plans from where the joints are to stand. A
    robot of which sensors read that a joint stands elsewhere, or does not follow on the way, lets its brakes close, and
    so does one for which nothing is found.

    Args:
        w: Safety weight; None for the planner's default.
        time_limit: What planning takes in the simulated world [s], the stop included, unless that takes longer.
        iterations: Of the planner; what makes the motion the same every time.
        deceleration: Of the stop, as of `StopOnFailure`.
        tolerance: How far from where it is to stand a joint may be read, in the mean over the last 0.2 s [rad or m].
        following: The same on its way to the goal, over 0.1 s: commands that are late are no reason to stop.
    """

    w: float | None = None
    time_limit: float = 0.5
    iterations: int = 300
    deceleration: float = 1.0
    tolerance: float = 0.05
    following: float = 0.25

    def __post_init__(self) -> None:
        if not (is_real(self.time_limit) and 0.0 <= self.time_limit < np.inf):
            raise SettingError("time_limit", self.time_limit, "a finite time >= 0 s")
        for name in ("tolerance", "following"):
            if not (is_real(getattr(self, name)) and getattr(self, name) > 0.0):
                raise SettingError(name, getattr(self, name), "a number > 0")
        StopOnFailure(deceleration=self.deceleration)

    def begin(self, task: PolicyTask, seed: int) -> Reaction:
        """Return the stop, and the motion after it."""
        return _GoingOn(self, task, seed)


class _GoingOn:
    """What `ReplanOnFailure` does in one episode."""

    def __init__(self, settings: ReplanOnFailure, task: PolicyTask, seed: int) -> None:
        self._settings, self._task, self._seed = settings, task, seed
        self._braking: _Braking | None = None
        self._follower: OpenLoop | None = None
        # What is read less what is desired; for the mean, noise is nothing.
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
    """Plan from a configuration to the goal; remembered, for episodes under many faults stop at the same place."""
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
        return None  # where it stands is no place to begin
    return found.trajectory if found.status is gp.PlanStatus.SOLVED else None


class Recovering:
    """A policy that is relieved once a fault has been noticed.

    Args:
        task: What is to be done.
        policy: Who acts until then.
        recovery: What is done from then on.
        noticed: When the fault is noticed, after the beginning [s]; infinite for never.
        seed: Of what the recovery draws.

    Raises:
        PolicyError: If the policy's actions take the place of the low-level controller, of which a recovery makes use.
    """

    def __init__(self, task: PolicyTask, policy: Policy, recovery: Recovery, noticed: float, seed: int) -> None:
        self._task, self._policy, self._recovery, self._noticed, self._seed = task, policy, recovery, noticed, seed
        self._reaction: Reaction | None = None
        self.action = action_kind(policy)
        if self.action == "command":
            raise PolicyError("of the user", "sends commands to actuators; a recovery can relieve it of other actions")

    def __call__(self, observation: Observation, /) -> ArrayLike:
        """Return what the policy does, or the recovery."""
        if self._reaction is None and observation.time >= self._noticed - 1e-9:
            self._reaction = self._recovery.begin(self._task, self._seed)
        if self.action == "brake":
            return np.zeros(0)  # for good
        if self._reaction is None:
            action = self._policy(observation)
            self.action = action_kind(self._policy)
            return action
        wanted = self._reaction(observation)
        self.action = "brake" if wanted is None else "joint_position"
        return np.zeros(0) if wanted is None else wanted


def recovering(factory: PolicyFactory, recovery: Recovery, onset: float, delay: float) -> PolicyFactory:
    """Return a policy that is relieved `delay` after the onset of a fault [s], the two counted as one."""
    if not 0.0 <= delay:
        raise SettingError("delay", delay, "a time >= 0 s")

    def make(task: PolicyTask, seed: int) -> Policy:
        return Recovering(task, factory(task, seed), recovery, onset + delay, seed)

    return make

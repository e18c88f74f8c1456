"""What a controller does after it has noticed a fault: nothing, stop, or plan again from where it is.

Noticing is perfect but late: `delay` after the onset, whatever the fault. How soon a fault is noticed in reality
depends on the monitor; ask for several delays.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

import graceful_plan as gp
from failbench.policies.adapters import OpenLoop
from failbench.policies.policy import Observation, Policy, PolicyFactory, action_kind
from failbench.policies.task import PolicyTask
from graceful_plan import GracefulPlanError
from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError

Array = np.ndarray

Reaction = Callable[[Observation], Float[Array, " nq"]]
"""Takes over from the policy: returns joint positions from the moment of noticing on."""


class Recovery(ABC):
    """What is done once a fault has been noticed: a contract, and frozen settings."""

    @abstractmethod
    def begin(self, task: PolicyTask, seed: int, last: Float[Array, "2 nq"]) -> Reaction:
        """Return what takes over.

        Args:
            task: What was to be done.
            seed: Of what is drawn.
            last: What the sensors read at the last two observations [rad or m].
        """


@dataclass(frozen=True, kw_only=True)
class StopOnFailure(Recovery):
    """A protective stop of category 1: all joints brake straight ahead, together; then they are held.

    Args:
        deceleration: Over the greatest acceleration that motions have.
    """

    deceleration: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.deceleration < np.inf:
            raise SettingError("deceleration", self.deceleration, "a finite number > 0")

    def begin(self, task: PolicyTask, seed: int, last: Float[Array, "2 nq"]) -> Reaction:
        """Return the stop."""
        period = task.settings.period
        speed = (last[1] - last[0]) / period
        braking = float((np.abs(speed) / (self.deceleration * task.scene.limits.acceleration)).max())
        began: list[float] = []

        def stop(observation: Observation) -> Float[Array, " nq"]:
            began[:] = began or [observation.time]
            time = min(observation.time - began[0] + period, braking)
            return last[1] + speed * (time - time**2 / (2.0 * braking) if braking > 0.0 else 0.0)

        return stop


@dataclass(frozen=True, kw_only=True)
class ReplanOnFailure(Recovery):
    """Stops, plans from where it stands, and goes on to its goal; the world goes on while it plans.

    A motion that is found sooner is begun no sooner, so that episodes do not depend on how fast the machine is. What is
    broken is not known to the planner: it takes what the sensors read, and the object for held. Where nothing is found,
    it stays where it is.

    Args:
        w: Safety weight; None for the planner's default.
        time_limit: What planning takes in the simulated world [s], the stop included.
        iterations: Of the planner; what makes the motion the same every time.
        deceleration: Of the stop, as of `StopOnFailure`.
    """

    w: float | None = None
    time_limit: float = 0.5
    iterations: int = 300
    deceleration: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.time_limit < np.inf:
            raise SettingError("time_limit", self.time_limit, "a finite time >= 0 s")
        StopOnFailure(deceleration=self.deceleration)

    def begin(self, task: PolicyTask, seed: int, last: Float[Array, "2 nq"]) -> Reaction:
        """Return the stop, and the motion after it."""
        stop = StopOnFailure(deceleration=self.deceleration).begin(task, seed, last)
        began: list[float] = []
        follower: list[OpenLoop | None] = []

        def go_on(observation: Observation) -> Float[Array, " nq"]:
            began[:] = began or [observation.time]
            waited = observation.time - began[0] - self.time_limit
            stopped = stop(observation)
            if waited < -1e-9:
                return stopped
            if not follower:
                follower.append(self._motion(task, observation.q, seed))
            return stopped if follower[0] is None else follower[0].at(waited, observation.q)

        return go_on

    def _motion(self, task: PolicyTask, q: Float[Array, " nq"], seed: int) -> OpenLoop | None:
        low, high = task.scene.limits.position.T
        try:
            found = gp.plan(
                np.clip(q, low, high),
                task.goal,
                task.scene,
                w=self.w,
                iterations=self.iterations,
                seed=seed,
                speed=task.settings.speed,
            )
        except GracefulPlanError:
            return None  # readings that are no configuration
        trajectory = found.trajectory if found.status is gp.PlanStatus.SOLVED else None
        return None if trajectory is None else OpenLoop(trajectory, task.settings.period)


class Recovering:
    """A policy that is relieved once a fault has been noticed.

    Args:
        task: What is to be done.
        policy: Who acts until then.
        recovery: What is done from then on.
        noticed: When the fault is noticed, after the beginning [s]; infinite for never.
        seed: Of what the recovery draws.
    """

    def __init__(self, task: PolicyTask, policy: Policy, recovery: Recovery, noticed: float, seed: int) -> None:
        self._task, self._policy, self._recovery, self._noticed, self._seed = task, policy, recovery, noticed, seed
        self._last: list[Float[Array, " nq"]] = []
        self._reaction: Reaction | None = None
        self.action = action_kind(policy)

    def __call__(self, observation: Observation, /) -> ArrayLike:
        """Return what the policy does, or the recovery."""
        self._last = [*self._last[-1:], observation.q]
        if self._reaction is None and observation.time >= self._noticed - 1e-9:
            last = np.array([self._last[0], self._last[-1]])
            self._reaction = self._recovery.begin(self._task, self._seed, last)
            self.action = "joint_position"
        return self._policy(observation) if self._reaction is None else self._reaction(observation)


def recovering(factory: PolicyFactory, recovery: Recovery, onset: float, delay: float) -> PolicyFactory:
    """Return a policy that is relieved `delay` after the onset of a fault [s], the two counted as one."""
    if not 0.0 <= delay:
        raise SettingError("delay", delay, "a time >= 0 s")

    def make(task: PolicyTask, seed: int) -> Policy:
        return Recovering(task, factory(task, seed), recovery, onset + delay, seed)

    return make

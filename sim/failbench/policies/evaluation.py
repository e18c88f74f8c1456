"""Evaluation of a policy: its success and harm, healthy and with each fault."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

import graceful_plan as gp
from failbench.basics.statistics import Estimate, check_confidence, estimate_mean, estimate_probability
from failbench.fault.fault import Fault
from failbench.policies.monitoring import Watch, monitored
from failbench.policies.policy import Policy, PolicyFactory
from failbench.policies.recovery import Recovery, recovering
from failbench.policies.report import PolicyFigures, PolicyReport
from failbench.policies.rollouts import PolicyRollout, roll_out
from failbench.policies.task import PolicyTask
from failbench.recording.records import RolloutRequest
from failbench.recording.score import greatest_touch
from failbench.report import FAILURES_PER_HOUR
from failbench.rollouts.sampling import MOST, Draws, check_whole, draw, thread_count
from failbench.validation import Scenarios, chosen_faults
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.setting_checks import not_negative

Progress = Callable[[int, int], None]


def evaluate(
    task: PolicyTask,
    factory: PolicyFactory,
    scenarios: Scenarios = "*/*/severe",
    *,
    n: int = 20,
    seed: int = 0,
    recovery: Recovery | None = None,
    delay: float = 0.1,
    watch: Watch | None = None,
    rate: float = FAILURES_PER_HOUR,
    confidence: float = 0.95,
    threads: int | None = None,
    progress: Progress | None = None,
) -> PolicyReport:
    """Run a policy on a task many times, healthy and with faults.

    Every fault is applied to the same n episodes as the healthy robot, with the same starts. It begins during the
    motion: its onset is a fraction of the duration of the same episode without a fault.

    Args:
        task: The task, see `policy_task`.
        factory: Creates the policy of each episode.
        scenarios: Faults to apply: fault objects, or patterns of the registry's tags or names such as "drop/*", of
            which only the faults are used.
        n: Number of episodes without a failure, and with each fault.
        seed: Seed of all random numbers. Evaluations with the same seed and n share starts, quantiles of the onsets,
            and seeds of the faults.
        recovery: Controller that takes over after a fault is detected.
        delay: Detection delay after the onset [s], for a recovery without `watch`.
        watch: Monitor that detects faults, of a policy that follows a planned motion. It also watches the episodes
            without a failure, in which each notice is a false alarm. None: faults are detected after the delay.
        rate: Failures per hour of all these faults together, for the harm per executed task.
        confidence: Confidence level of the intervals.
        threads: Number of simulation threads; None for one per core. It does not affect the result.
        progress: Called with the numbers of finished and of all episodes.

    Raises:
        UnknownNameError: If a pattern matches nothing, or a fault strikes a joint that the robot does not have.
        PolicyError: If an action has the wrong shape, or is not finite.
        SettingError: If a setting is out of range.
    """
    faults = chosen_faults(scenarios)
    check_whole("n", n, 1, MOST)
    check_whole("seed", seed, 0)
    check_confidence(confidence)
    for name, value in (("rate", rate), ("delay", delay)):
        not_negative(name, value)
    if recovery is not None and not isinstance(recovery, Recovery):
        raise SettingError("recovery", recovery, "a Recovery, such as StopOnFailure()")
    if watch is not None and recovery is None:
        raise SettingError("recovery", recovery, "a Recovery, which begins when the monitor notices something")
    work = _Work(task, factory, thread_count(threads), recovery, delay, watch)
    draws, starts = draw(seed, n), [seed + i for i in range(n)]
    total = n * (1 + len(faults))
    healthy = work.episodes(starts, None)
    if progress is not None:
        progress(n, total)
    lasts = [rollout.reached or rollout.duration for rollout in healthy]
    found: dict[str, list[PolicyRollout]] = {}
    for i, fault in enumerate(faults):
        jobs = [_job(fault, draws, k, last) for k, last in enumerate(lasts)]
        found[_label(fault, found)] = work.episodes(starts, jobs)
        if progress is not None:
            progress(n * (2 + i), total)
    scene = task.scene
    greatest = greatest_touch(scene)
    twins = np.array([rollout.harm(scene) for rollout in healthy])
    return PolicyReport(
        task=task.name,
        healthy=_figures(healthy, scene, greatest, confidence),
        by_fault={k: _figures(v, scene, greatest, confidence, twins) for k, v in found.items()},
        duration=float(np.mean(lasts)),
        rate=rate,
        recovery="none" if recovery is None else f"{recovery}, {_detection(watch, delay)}",
        n=n,
        seed=seed,
        confidence=confidence,
        versions={"graceful_plan": gp.__version__},
        healthy_rollouts=tuple(healthy),
        rollouts={k: tuple(v) for k, v in found.items()},
    )


def _detection(watch: Watch | None, delay: float) -> str:
    return f"{delay:g} s after the onset" if watch is None else "when the monitor notices"


class _Work(NamedTuple):
    task: PolicyTask
    factory: PolicyFactory
    threads: int
    recovery: Recovery | None
    delay: float
    watch: Watch | None

    def episodes(self, seeds: Sequence[int], jobs: Sequence[RolloutRequest] | None) -> list[PolicyRollout]:
        """Run episodes; with faults, the recovery takes over after the detection delay."""
        if self.recovery is not None and self.watch is not None:
            factory = monitored(self.factory, self.recovery, self.watch)
            return roll_out(self.task, factory, seeds, jobs, threads=self.threads)
        if jobs is None or self.recovery is None:
            return roll_out(self.task, self.factory, seeds, jobs, threads=self.threads)
        noticed = dict(zip(seeds, (job.onset for job in jobs), strict=True))
        recovery = self.recovery

        def make(task: PolicyTask, seed: int) -> Policy:
            return recovering(self.factory, recovery, noticed[seed], self.delay)(task, seed)

        return roll_out(self.task, make, seeds, jobs, threads=self.threads)


def _job(fault: Fault, draws: Draws, k: int, last: float) -> RolloutRequest:
    """Return the k-th episode's job; `last` is the duration of the episode without a fault [s]."""
    return RolloutRequest(fault=fault, onset=fault.when.onset(float(draws.quantile[k]), last), seed=int(draws.seed[k]))


def _label(fault: Fault, taken: dict[str, list[PolicyRollout]]) -> str:
    """Return a unique label of a fault: its name and degree, numbered if taken."""
    name = label = f"{fault.NAME}/{fault.degree}"
    number = 1
    while label in taken:
        number += 1
        label = f"{name} ({number})"
    return label


def _figures(
    rollouts: Sequence[PolicyRollout],
    scene: gp.Scene,
    greatest: float,
    confidence: float,
    twins: Float[Array, " n"] | None = None,
) -> PolicyFigures:
    """Return the figures of episodes; `twins` is the harm of the same episodes without a fault, for the added harm."""
    harm = np.array([rollout.harm(scene) for rollout in rollouts])
    valid = np.isfinite(harm) if twins is None else np.isfinite(harm) & np.isfinite(twins)

    def mean(values: Float[Array, " n"], low: float, high: float) -> Estimate:
        return estimate_mean(values[valid], (low, high), confidence=confidence)

    def share(hits: Sequence[bool]) -> Estimate:
        return estimate_probability(np.array(hits)[valid], confidence=confidence)

    return PolicyFigures(
        success=share([rollout.success for rollout in rollouts]),
        harm=mean(harm, 0.0, greatest),
        added=None if twins is None else mean(harm - twins, -greatest, greatest),
        dropped=share([rollout.dropped for rollout in rollouts]),
        spilled=mean(np.array([rollout.spilled for rollout in rollouts]), 0.0, 1.0),
        diverged=int(np.count_nonzero(~valid)),
    )

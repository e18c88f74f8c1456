"""Choice among motions by simulated failures, for motions that are executed often.

Motions race in rounds with common random numbers: the same faults, seeds and quantiles of onsets for each. After each
round the worse half is dropped and the number of failures per motion doubles (successive halving), until one motion is
left, the best of the last two is sure, or the time is over.

References:
    [Karnin2013] Z. Karnin, T. Koren, O. Somekh, "Almost optimal exploration in multi-armed bandits", ICML 2013. Differs
    in that earlier failures of the remaining motions count as well.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from failbench.basics.errors import ExecutionRefused
from failbench.basics.statistics import Estimate, check_confidence, estimate_difference, estimate_mean
from failbench.fault.fault import Fault
from failbench.recording.healthy import whole_execution
from failbench.recording.score import greatest_touch, observed_impact
from failbench.report import FAILURES_PER_HOUR
from failbench.rollouts.execution import Execution, execute
from failbench.rollouts.rollout import run_rollouts
from failbench.rollouts.sampling import check_whole, make_requests, thread_count
from failbench.simulated.world import SimSettings, build_world
from failbench.surroundings.registry import scene_with_intruder
from failbench.validation import Motion, Scenarios, chosen_faults
from graceful_plan import PlanResult, Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.setting_checks import not_negative

_FIRST = 16
"""Failures per motion in the first round, rounded up to a multiple of the number of faults: in fewer, harm is rare."""
_ROUNDS = 12
"""Greatest number of rounds; the last one has 2^11 times as many failures as the first."""


@dataclass(frozen=True, kw_only=True)
class MotionChoice:
    """Result of `choose`.

    Args:
        best: Index of the chosen motion.
        harm: Harm per executed task of each motion, from the failures up to its last round; None for motions that
            cannot be executed.
        n: Failures of each motion.
        sure: Whether the chosen motion does less harm than each motion that raced it to the last round, by the
            confidence asked for. Also true if no other motion can be executed.
        refused: Reasons why motions cannot be executed, by index.
        seconds: Duration of the call [s].
    """

    best: int
    harm: tuple[Estimate | None, ...]
    n: tuple[int, ...]
    sure: bool
    refused: Mapping[int, str]
    seconds: float

    def __str__(self) -> str:
        rows = [
            f"motion {i}: {self.refused[i] if estimate is None else f'{estimate} per task, {n} failures'}"
            for i, (estimate, n) in enumerate(zip(self.harm, self.n, strict=True))
        ]
        how = "surely the best" if self.sure else "the best so far"
        return "\n".join([f"motion {self.best} is {how}", *rows])


def choose(
    motions: PlanResult | Sequence[Motion],
    scene: Scene,
    scenarios: Scenarios = "*/*/severe",
    *,
    seconds: float = 10.0,
    rounds: int | None = None,
    horizon: float = 1.0,
    seed: int = 0,
    rate: float = FAILURES_PER_HOUR,
    threads: int | None = None,
    settings: SimSettings | None = None,
    confidence: float = 0.95,
) -> MotionChoice:
    """Choose the motion that does the least harm per executed task in simulated failures.

    Args:
        motions: Motions, as for `validate`; or the result of `plan(..., candidates=8)`, for its candidates.
        scene: The scene with the carried object attached: `task.scene`.
        scenarios: Faults, as for `validate`.
        seconds: Time after which no further round begins [s].
        rounds: Greatest number of rounds; with a generous `seconds` it makes the choice reproducible. None: as many as
            the time allows.
        horizon: Simulated time after the onset [s].
        seed: Seed of all random numbers.
        rate: Failures per hour of motion.
        threads: Number of simulation threads; None for one per core.
        settings: Settings of the simulation.
        confidence: Probability with which the choice is sure, against a single other motion.

    Raises:
        SettingError: If there are no motions, or a setting is out of range.
        ExecutionRefused: If no motion can be executed.
        PlanningFailed: If `motions` is the result of a failed plan.
        UnknownNameError: If a pattern matches nothing, or a fault strikes a joint that the robot does not have.
    """
    began = time.perf_counter()
    if isinstance(motions, PlanResult):
        motions = motions.candidates or (motions,)
    if not len(motions):
        raise SettingError("motions", motions, "at least one motion")
    for name, value in (("seconds", seconds), ("rate", rate)):
        not_negative(name, value)
    most = _ROUNDS if rounds is None else rounds
    check_whole("rounds", most, 1, _ROUNDS)
    check_whole("seed", seed, 0)
    check_confidence(confidence)
    faults, cores = chosen_faults(scenarios), thread_count(threads)
    for fault in faults:
        scene = scene_with_intruder(fault, scene)
    world = build_world(scene, settings)
    racers: dict[int, _Racer] = {}
    refused: dict[int, str] = {}
    last: ExecutionRefused | None = None
    for i, motion in enumerate(motions):
        try:
            racers[i] = _Racer(execute(motion, world), rate)
        except ExecutionRefused as error:
            refused[i], last = str(error), error
    if last is not None and not racers:
        raise last
    left, sure = sorted(racers), len(racers) == 1
    each = 1.0 - (1.0 - confidence) / most  # of as many looks at the difference as there may be rounds
    for number in range(most):
        for i in left:
            racers[i].race(faults, number, seed=seed, horizon=horizon, threads=cores)
        left.sort(key=lambda i: racers[i].mean)
        if len(left) <= 2:
            sure = len(left) == 1 or _surely_better(racers[left[0]], racers[left[1]], each)
        if sure or number + 1 == most or time.perf_counter() - began > seconds:
            break
        left = left[: max(2, -(-len(left) // 2))]
    return MotionChoice(
        best=left[0],
        harm=tuple(racers[i].estimate(confidence) if i in racers else None for i in range(len(motions))),
        n=tuple(len(racers[i].harm) if i in racers else 0 for i in range(len(motions))),
        sure=sure,
        refused=refused,
        seconds=time.perf_counter() - began,
    )


class _Racer:
    """A motion and the harm per task of its failures."""

    def __init__(self, execution: Execution, rate: float) -> None:
        self._execution = execution
        self._failures = rate * execution.duration / 3600.0
        scene = execution.world.scene
        self._certain = max(0.0, 1.0 - self._failures) * execution.healthy.harm
        self.greatest = self._failures * greatest_touch(scene)
        self.harm: Float[Array, " n"] = np.zeros(0)

    def race(self, faults: Sequence[Fault], number: int, *, seed: int, horizon: float, threads: int) -> None:
        """Simulate the failures of a round; motions that diverge in one are left without its harm."""
        execution = self._execution
        n = -(-_FIRST // len(faults)) * len(faults) * 2**number
        # Numbers of failures differ between rounds, and with them the draws.
        jobs = make_requests(faults, execution.duration, n=n, seed=seed)
        rollouts = run_rollouts(execution, jobs, horizon=horizon, threads=threads)
        scene, healthy = execution.world.scene, execution.healthy
        found = [
            self._failures * observed_impact(whole_execution(rollout, healthy), scene)
            if rollout.status == "completed"
            else np.nan
            for rollout in rollouts
        ]
        self.harm = np.append(self.harm, self._certain + np.array(found))

    @property
    def mean(self) -> float:
        """Mean harm per executed task."""
        return float(np.nanmean(self.harm))

    def estimate(self, confidence: float) -> Estimate:
        """Return the harm per executed task."""
        known = self.harm[np.isfinite(self.harm)] - self._certain
        return estimate_mean(known, (0.0, self.greatest), confidence=confidence).shifted(self._certain)


def _surely_better(first: _Racer, second: _Racer, confidence: float) -> bool:
    """Return whether the first motion does less harm, by paired failures."""
    paired = np.isfinite(first.harm + second.harm)
    greatest = max(first.greatest, second.greatest)
    bounds = (0.0, greatest + max(first.harm[paired].max(initial=0.0), second.harm[paired].max(initial=0.0)))
    found = estimate_difference(second.harm[paired], first.harm[paired], bounds, confidence=confidence)
    return found.low > 0.0

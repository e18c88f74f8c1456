"""Parallel episodes of a policy, and their outcomes."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from failbench.policies.batch import EpisodeBatch
from failbench.policies.cameras import PolicyCameras
from failbench.policies.episode import Camera, Episode
from failbench.policies.policy import Policy, PolicyFactory, action_kind
from failbench.policies.task import PolicyTask
from failbench.recording.records import ContactEvent, RolloutRequest
from failbench.recording.score import observed_impact
from failbench.rollouts.sampling import MOST, MOST_THREADS, check_whole
from graceful_plan import Notice, Scene
from graceful_plan.exceptions import SettingError


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyRollout:
    """Outcome of one episode.

    Args:
        seed: Seed of the start, and of the policy's draws.
        job: The fault and its onset; None for no fault.
        onset: Onset of the fault, after the beginning [s]; None without a fault.
        status: "completed", or "diverged" if the simulation blew up; then there are no consequences.
        reached: Time at which the tool had been at its goal for the dwell time [s]; None if it is not there at the end.
        distance: Distance of the tool from its goal at the end [m and rad].
        duration: Duration of the episode [s].
        events: Contacts with entities in the whole episode, without initial touches and touches that the scene allows.
        landings: Other contacts of the carried object, see `Rollout`.
        dropped: Whether the carried object left the gripper.
        spilled: Lost fraction of the contents, in [0, 1].
        fell: Entities that ended more than 5 cm below their initial height.
        tipped: Entities that ended more than 30 degrees off their initial axis.
        notice: Notice of the monitor that watched the episode; None if it noticed nothing or there was none.
    """

    seed: int
    job: RolloutRequest | None
    onset: float | None
    status: str
    reached: float | None
    distance: tuple[float, float]
    duration: float
    events: tuple[ContactEvent, ...] = ()
    landings: tuple[ContactEvent, ...] = ()
    dropped: bool = False
    spilled: float = 0.0
    fell: tuple[str, ...] = ()
    tipped: tuple[str, ...] = ()
    notice: Notice | None = None

    @property
    def success(self) -> bool:
        """Whether the tool reached its goal and still holds its object."""
        return self.status == "completed" and self.reached is not None and not self.dropped

    def harm(self, scene: Scene) -> float:
        """Return the sum of the severities of all hits; NaN if the simulation blew up."""
        return observed_impact(self, scene) if self.status == "completed" else float("nan")


def roll_out(
    task: PolicyTask,
    factory: PolicyFactory,
    seeds: Sequence[int],
    jobs: Sequence[RolloutRequest | None] | None = None,
    *,
    threads: int = 1,
    batch: int = 16,
) -> list[PolicyRollout]:
    """Run a policy in episodes.

    Args:
        task: The task.
        factory: Creates the policy of each episode.
        seeds: Seeds of the episodes; an episode depends only on its seed and job.
        jobs: Fault of each episode and its onset after the beginning [s]; None for no faults.
        threads: Number of simulation threads.
        batch: Number of episodes in memory at once.

    Raises:
        PolicyError: If an action has the wrong shape, or is not finite.
        SettingError: If the numbers of jobs and seeds differ.
    """
    wanted: Sequence[RolloutRequest | None] = [None] * len(seeds) if jobs is None else jobs
    if len(wanted) != len(seeds):
        raise SettingError("jobs", len(wanted), f"a job for each of the {len(seeds)} seeds")
    check_whole("threads", threads, 1, MOST_THREADS)
    check_whole("batch", batch, 1, MOST)
    for seed in seeds:
        check_whole("seed", seed, 0)
    if not seeds:
        return []
    todo = deque(enumerate(zip(seeds, wanted, strict=True)))
    found: list[PolicyRollout | None] = [None] * len(seeds)
    with PolicyCameras(task) as camera:
        runner = _Runner(task, factory, min(batch, len(seeds)), threads, camera)
        while todo or runner.running:
            for sim in runner.free:
                if todo:
                    number, (seed, job) = todo.popleft()
                    runner.begin(sim, number, seed, job)
            for number, rollout in runner.advance():
                found[number] = rollout
    return [rollout for rollout in found if rollout is not None]


class _Runner:
    """Runs episodes in a batch of simulations, each with its policy."""

    def __init__(
        self, task: PolicyTask, factory: PolicyFactory, count: int, threads: int, camera: Camera | None
    ) -> None:
        self._task, self._factory = task, factory
        self._batch = EpisodeBatch(task, count, threads=threads, camera=camera)
        self._count = count
        self.running: dict[int, tuple[int, int, Policy]] = {}

    @property
    def free(self) -> list[int]:
        return [sim for sim in range(self._count) if sim not in self.running]

    def begin(self, sim: int, number: int, seed: int, job: RolloutRequest | None) -> None:
        self._batch.begin(sim, np.random.default_rng([seed, 0]), job)
        self.running[sim] = number, seed, self._factory(self._task, seed)

    def advance(self) -> list[tuple[int, PolicyRollout]]:
        """Simulate one period and return the episodes that ended."""
        actions: dict[int, Any] = {}
        for sim, (_, _, policy) in self.running.items():
            episode = self._batch.episodes[sim]
            assert episode is not None
            action = policy(episode.observation)
            actions[sim] = action_kind(policy), action  # in this order, since the call may change the kind
        self._batch.advance(actions)
        ended = []
        for sim in list(self.running):
            episode = self._batch.episodes[sim]
            assert episode is not None
            if episode.over or self._batch.diverged(sim):
                number, seed, policy = self.running.pop(sim)
                found = outcome(episode, seed, diverged=self._batch.diverged(sim))
                ended.append((number, replace(found, notice=getattr(policy, "notice", None))))
        return ended


def outcome(episode: Episode, seed: int, *, diverged: bool) -> PolicyRollout:
    """Return the outcome of an episode that is over."""
    onset = episode.onset * episode.task.world.settings.timestep
    fields = {} if diverged else episode.finish()
    names = ("events", "landings", "dropped", "spilled", "fell", "tipped")
    return PolicyRollout(
        seed=seed,
        job=episode.job,
        onset=None if episode.job is None else onset,
        status="diverged" if diverged else "completed",
        reached=None if diverged else episode.reached,
        distance=episode.distance,
        duration=episode.time,
        **{name: fields[name] for name in names if name in fields},
    )

"""Episodes in parallel on MuJoCo's native batch: stepped together, but independent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike

from failbench.fault.fault import SURROUNDINGS
from failbench.policies.episode import Camera, Episode, Live
from failbench.policies.servoing import Servoing
from failbench.policies.task import PolicyTask
from failbench.recording.records import RolloutRequest
from failbench.simulated.rest import let_sleep
from failbench.simulated.states import control_spec, put, warnings_counted_only
from failbench.simulated.stiction import EVERY, SURFACE, Stiction
from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError

_COUNT = 1
"""Column of a simulation's warnings that counts them."""


class EpisodeBatch:
    """Simulations of one task, with an independent episode in each.

    Args:
        task: The task.
        count: Number of simulations.
        threads: Number of simulation threads.
        camera: Takes pictures for policies that use them.
    """

    def __init__(self, task: PolicyTask, count: int, *, threads: int = 1, camera: Camera | None = None) -> None:
        self.task, self._camera = task, camera
        self._batch = Batch(task.world.model, count, nthread=threads, persistent=True)
        self._fields: dict[str, Array] = {}
        self._policy = self._field("tree_sleep_policy")
        self._stiction = Stiction(task.world, self._batch, self._field(SURFACE))
        self._servoing = [Servoing(task) for _ in range(count)]
        self._qpos, self._qvel, self._active, self._xpos, self._force = (
            self._batch.bind(name) for name in ("qpos", "qvel", "eq_active", "xpos", "actuator_force")
        )
        model = task.world.model
        self._spec = control_spec(model)
        self._sizes = {"sensordata": model.nsensordata, "qpos": model.nq, "qvel": model.nv}
        most = count * task.settings.steps
        # Reused memory: page faults of fresh arrays cost more than the writes.
        self._room = {name: np.empty(most * size) for name, size in self._sizes.items()}
        self.episodes: list[Episode | None] = [None] * count

    def begin(self, sim: int, rng: np.random.Generator, job: RolloutRequest | None = None) -> Episode:
        """Begin a new episode in a simulation.

        Args:
            sim: Index of the simulation.
            rng: Generator of the episode's start.
            job: The fault and its onset after the beginning [s]; None for no fault.

        Raises:
            UnknownNameError: If the fault strikes a joint that the robot does not have.
            SettingError: If it is a fault of the surroundings, or its rates do not match the robot's joints.
        """
        task = self.task
        if job is not None:
            fault = job.fault
            if fault.CATEGORY == SURROUNDINGS:
                raise SettingError(
                    "fault", fault.NAME, "a fault of the robot; those of the surroundings need a planned motion"
                )
            task.world.robot.check_targets(fault.targets or fault.TARGETS, fault.rates)
        q, state = task.begin(rng)
        for name, values in self._fields.items():
            values[sim] = getattr(task.world.model, name)
        put(self._batch, np.array([sim]), state[None])
        self._stiction.begin(np.array([sim]))
        self._servoing[sim].begin(q)
        live = Live(
            fields=partial(self._field_of, sim),
            qpos=self._qpos[sim],
            qvel=self._qvel[sim],
            eq_active=self._active[sim],
            force=self._force[sim],
        )
        self.episodes[sim] = episode = Episode(task, self._servoing[sim], job, live, self._camera)
        return episode

    def advance(self, actions: Mapping[int, tuple[str, ArrayLike]]) -> None:
        """Simulate one period.

        Args:
            actions: Kind and action for each simulation to advance.

        Raises:
            PolicyError: If an action has the wrong shape, or is not finite.
            SettingError: If an episode has not begun, or is over.
        """
        sims = np.array(sorted(actions))
        episodes = [self._running(sim) for sim in sims.tolist()]
        for sim, episode in zip(sims.tolist(), episodes, strict=True):
            episode.order(*actions[sim])
        left = self.task.settings.steps
        with warnings_counted_only():
            while left > 0:
                for episode in episodes:
                    episode.act()
                count = min(left, *(episode.until_event for episode in episodes))
                self._step(sims, episodes, count)
                left -= count
        for episode in episodes:
            episode.end_period()

    def diverged(self, sim: int) -> bool:
        """Return whether a simulation has diverged; its state is then meaningless."""
        return bool(self._batch.warning[sim, :, _COUNT].any())

    def _step(self, sims: Array, episodes: list[Episode], count: int) -> None:
        self._stiction.begin(sims[[episode.step == episode.onset for episode in episodes]])
        commands = np.stack([episode.commands(count) for episode in episodes])
        shapes = {name: (len(sims), count, size) for name, size in self._sizes.items()}
        out = {name: self._room[name][: math.prod(shape)].reshape(shape) for name, shape in shapes.items()}
        self._batch.rollout(count, commands, self._spec, record=tuple(self._sizes), ids=sims, out=out)
        for i, episode in enumerate(episodes):
            episode.after(out["sensordata"][i], out["qpos"][i], out["qvel"][i])
        tired = sims[[episode.looks_for_sleep for episode in episodes]]
        self._stiction.update(
            sims[[episode.step % EVERY == 0 and episode.step < episode.onset for episode in episodes]]
        )
        if len(tired):
            policy = self._policy[tired]
            let_sleep(self.task.world, self._xpos[tired], policy)
            self._policy[tired] = policy

    def _running(self, sim: int) -> Episode:
        episode = self.episodes[sim]
        if episode is None or episode.timed_out:
            raise SettingError("episode", sim, "one that has begun and is not over: reset it first")
        return episode

    def _field_of(self, sim: int, name: str) -> Array:
        return self._field(name)[sim]

    def _field(self, name: str) -> Array:
        """Return a model field that simulations can change separately; expand it at the first use."""
        if name not in self._fields:
            self._fields[name] = self._batch.expand(name)
            self._fields[name][:] = getattr(self.task.world.model, name)
        return self._fields[name]

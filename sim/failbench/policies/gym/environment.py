"""FailBench's tasks as Gymnasium environments; they need the extra `policies`.

Actions are in [-1, 1]. Joint positions are scaled to the joints' ranges, joint velocities to their limits. Tool poses
are increments per period [m, rad] from the current target pose. Observations are `policy.Observation.vector`; with
cameras, a dictionary of that vector and the pictures.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import mujoco
import numpy as np

from failbench.basics.errors import MissingExtra
from failbench.fault.fault import Fault
from failbench.policies.batch import EpisodeBatch
from failbench.policies.cameras import PolicyCameras
from failbench.policies.episode import Camera, Episode
from failbench.policies.gym.faulting import FaultSampler
from failbench.policies.gym.spaces import Spaces
from failbench.policies.policy import Observation
from failbench.policies.rollouts import outcome
from failbench.policies.task import PolicySettings, PolicyTask, policy_task
from failbench.rollouts.sampling import check_whole
from graceful_plan.array_types import Array, Bool, Float, Int, UInt8
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError
from graceful_plan.setting_checks import not_negative

try:
    import gymnasium
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode, VectorEnv
except ImportError:
    raise MissingExtra("gymnasium", "policies") from None


REWARDS = ("joint_distance", "success")
_SHARED = ("action", "reward", "harm_weight", "settings")
"""Settings of environments that vector environments share."""
_MOST_ENVIRONMENTS = 10_000
"""Greatest number of environments; each takes some hundred kilobytes."""
_BONUS = 1.0
"""Reward for reaching the goal."""


class FailBenchEnv(gymnasium.Env[Any, Array]):
    """One task, with one fault or without.

    The reward "joint_distance" is the decrease of the joints' distance from the goal, relative to the start-goal
    distance. A bonus of 1 is added once the tool has been at its goal for the dwell time. At the episode's end,
    `harm_weight` times its harm is subtracted, and `info["rollout"]` holds the outcome.

    Args:
        task: "SCENE/TASK", or a `PolicyTask`.
        fault: Fault of each episode; None for no fault. See also `wrappers.WithFaults`.
        action: "joint_position", "joint_velocity" or "tool_pose".
        reward: "joint_distance", or "success" for the bonus alone.
        harm_weight: Weight of harm in the reward.
        settings: Settings of the episodes, if `task` is a name.
        render_mode: "rgb_array", or None.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 - as in Gymnasium

    def __init__(
        self,
        task: str | PolicyTask,
        fault: Fault | None = None,
        *,
        action: str = "joint_velocity",
        reward: str = "joint_distance",
        harm_weight: float = 0.1,
        settings: PolicySettings | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UnknownNameError("render_mode", str(render_mode), self.metadata["render_modes"])
        self.core = _Core(task, fault, action=action, reward=reward, harm_weight=harm_weight, settings=settings)
        self.render_mode = render_mode
        self.action_space, self.observation_space = self.core.spaces.action, self.core.spaces.observation
        self._shown: Camera | None = None

    @property
    def task(self) -> PolicyTask:
        """The task."""
        return self.core.task

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Seed of this episode and of later episodes without a seed.
            options: "fault": the `Fault` of this episode, or None for none. "onset": its onset [s].
        """
        super().reset(seed=seed)
        self.core.begin(0, self.np_random, options or {})
        return self.core.spaces.observed(self.core.seen(0)), {}

    def step(self, action: Array) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Simulate one period."""
        self.core.advance({0: action})
        reward, terminated, truncated, info = self.core.judged(0)
        return self.core.spaces.observed(self.core.seen(0)), reward, terminated, truncated, info

    def render(self) -> UInt8[Array, "height width 3"] | None:  # type: ignore[override]
        """Return a picture of the whole scene; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        if self._shown is None:
            self._pictures = PolicyCameras(self.core.task, ("",))
            self._shown = self._pictures.__enter__()
        assert self._shown is not None
        return self._shown(self.core.qpos(0))[""]

    def close(self) -> None:
        """Free the renderers."""
        if self._shown is not None:
            self._pictures.__exit__(None, None, None)
            self._shown = None
        self.core.close()


class FailBenchVectorEnv(VectorEnv[Any, Array, Array]):
    """Many `FailBenchEnv` on MuJoCo's native batch; simulation i with seed s equals the one with seed s + i.

    Args:
        num_envs: Number of environments.
        task: "SCENE/TASK", or a `PolicyTask`.
        fault: Fault of each episode; None for no fault.
        threads: Number of simulation threads.
        **settings: Settings as for `FailBenchEnv`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as in Gymnasium
        "autoreset_mode": AutoresetMode.NEXT_STEP,
        "render_modes": [],
    }

    def __init__(
        self, num_envs: int, task: str | PolicyTask, fault: Fault | None = None, *, threads: int = 1, **settings: Any
    ) -> None:
        for name in settings:
            if name not in _SHARED:
                raise UnknownNameError("setting", name, _SHARED)
        self.num_envs = num_envs
        self.core = _Core(task, fault, **settings, count=num_envs, threads=threads)
        spaces = self.core.spaces
        self.single_action_space, self.single_observation_space = spaces.action, spaces.observation
        self.action_space = gymnasium.vector.utils.batch_space(spaces.action, num_envs)
        self.observation_space = gymnasium.vector.utils.batch_space(spaces.observation, num_envs)
        self._rngs: list[np.random.Generator] = []
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment."""
        if seed is not None or not self._rngs:
            rngs = (np_random(None if seed is None else seed + i) for i in range(self.num_envs))
            self._rngs = [rng for rng, _ in rngs]
        for i, rng in enumerate(self._rngs):
            self.core.begin(i, rng, options or {})
        self._over[:] = False
        return self._observed(), {}

    def step(
        self, actions: Array
    ) -> tuple[Any, Float[Array, " env"], Bool[Array, " env"], Bool[Array, " env"], dict[str, Any]]:
        """Simulate one period; where the episode had ended, begin the next one instead."""
        again: Int[Array, " env"] = np.flatnonzero(self._over)
        running = np.flatnonzero(~self._over)
        for i in again.tolist():
            self.core.begin(i, self._rngs[i], {})
        if len(actions) != self.num_envs:
            raise ShapeError("actions", np.shape(actions), f"({self.num_envs}, ...), a row for each environment")
        if len(running):
            self.core.advance({i: actions[i] for i in running.tolist()})
        rewards, ended, cut = np.zeros(self.num_envs), np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        infos: dict[str, Any] = {}
        for i in running.tolist():
            rewards[i], ended[i], cut[i], info = self.core.judged(i)
            infos = self._add_info(infos, info, i)
        self._over = ended | cut
        return self._observed(), rewards, ended, cut, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Free the renderers."""
        self.core.close()

    def _observed(self) -> Any:
        rows = [self.core.spaces.observed(self.core.seen(i)) for i in range(self.num_envs)]
        empty = gymnasium.vector.utils.create_empty_array(self.single_observation_space, self.num_envs)
        return gymnasium.vector.utils.concatenate(self.single_observation_space, rows, empty)


class _Core:
    """Common part of both kinds of environments: episodes, spaces and rewards."""

    def __init__(
        self,
        task: str | PolicyTask,
        fault: Fault | None,
        *,
        action: str = "joint_velocity",
        reward: str = "joint_distance",
        harm_weight: float = 0.1,
        settings: PolicySettings | None = None,
        count: int = 1,
        threads: int = 1,
    ) -> None:
        if reward not in REWARDS:
            raise UnknownNameError("reward", reward, REWARDS)
        not_negative("harm_weight", harm_weight)
        check_whole("num_envs", count, 1, _MOST_ENVIRONMENTS)
        check_whole("threads", threads, 1, _MOST_ENVIRONMENTS)
        if not isinstance(task, PolicyTask | str) or not isinstance(settings, PolicySettings | None):
            raise SettingError("task or settings", (task, settings), "a name or PolicyTask, and PolicySettings")
        self.task = policy_task(task, settings) if isinstance(task, str) else task
        self.spaces = Spaces(self.task, action)
        self.faulting = FaultSampler(fault)
        self._reward, self._harm_weight = reward, harm_weight
        self._pictures = PolicyCameras(self.task)
        self._batch = EpisodeBatch(self.task, count, threads=threads, camera=self._pictures.__enter__())
        self._whole = float(np.linalg.norm(self.task.goal - self.task.start))
        self._left = np.zeros(count)
        self._bonus = np.zeros(count, dtype=bool)
        self._model: mujoco.MjModel = self.task.world.model

    def begin(self, sim: int, rng: np.random.Generator, options: dict[str, Any]) -> None:
        job = self.faulting.job(self.task, rng, options)
        self._batch.begin(sim, rng, job)
        self.spaces.begin(sim, self.seen(sim))
        self._left[sim], self._bonus[sim] = self._distance(sim), False

    def advance(self, actions: dict[int, Array]) -> None:
        self._batch.advance({i: self.spaces.meant(i, action) for i, action in actions.items()})

    def seen(self, sim: int) -> Observation:
        return self.episode(sim).observation

    def qpos(self, sim: int) -> Float[Array, " qpos"]:
        return self.episode(sim).qpos

    def episode(self, sim: int) -> Episode:
        episode = self._batch.episodes[sim]
        assert episode is not None, "reset it first"
        return episode

    def judged(self, sim: int) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, whether the episode terminated, whether it timed out, and the outcome at its end."""
        episode, diverged = self.episode(sim), self._batch.diverged(sim)
        left = self._distance(sim)
        reward = (self._left[sim] - left) / self._whole if self._reward == "joint_distance" else 0.0
        self._left[sim] = left
        if episode.reached is not None and not self._bonus[sim]:
            self._bonus[sim], reward = True, reward + _BONUS
        terminated = diverged or (episode.over and episode.reached is not None)
        truncated = episode.timed_out and not terminated
        if not (terminated or truncated):
            return float(reward), False, False, {}
        rollout = outcome(episode, 0, diverged=diverged)
        harm = rollout.harm(self.task.scene)
        info = {"rollout": rollout, "harm": harm, "is_success": rollout.success}
        return float(reward - (0.0 if diverged else self._harm_weight * harm)), terminated, truncated, info

    def close(self) -> None:
        self._pictures.__exit__(None, None, None)

    def _distance(self, sim: int) -> float:
        q = self.episode(sim).qpos[self.task.world.robot.qpos]
        return float(np.linalg.norm(q - self.task.goal))

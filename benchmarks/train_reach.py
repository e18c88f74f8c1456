"""Train the policy `reach` that FailBench ships: PPO on a reaching task, a few minutes on one core.

make .venv/.policies && .venv/bin/python benchmarks/train_reach.py [STEPS]

Needs Stable-Baselines3 and torch. The weights are stored as NumPy arrays, so running the policy
needs neither. The network sees the distance of the joints from their goal and their velocities: no surroundings and no
faults.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from failbench.policies.adapters import REACH, reach_features
from failbench.policies.gym.environment import FailBenchEnv
from failbench.policies.mlp import Mlp
from failbench.policies.task import PolicySettings

TASKS = ("tabletop_l1/green_to_blue", "tabletop_l1/right_to_left", "tabletop_l1/far_to_near")
SETTINGS = PolicySettings(noise=0.3, limit=3.0)
"""Standard deviation of the starts, large so that paths to the goal vary."""
STEPS = 60_000


class ReachFeatures(gymnasium.ObservationWrapper[np.ndarray, np.ndarray, np.ndarray]):
    """Features of the network of `reach`."""

    def __init__(self, env: FailBenchEnv) -> None:
        super().__init__(env)
        size = 2 * len(env.task.start)
        self.observation_space = gymnasium.spaces.Box(-20.0, 20.0, (size,), np.float32)
        self._core = env.core

    def observation(self, observation: np.ndarray) -> np.ndarray:
        """Return the features."""
        seen = self._core.seen(0)
        return reach_features(seen.q, seen.qd, seen.goal).astype(np.float32)


def train(steps: int) -> Mlp:
    """Train a policy."""
    torch.set_num_threads(1)

    def make(task: str) -> Any:
        return lambda: ReachFeatures(FailBenchEnv(task, settings=SETTINGS, harm_weight=0.0))

    environments = VecMonitor(DummyVecEnv([make(task) for task in TASKS for _ in range(2)]))
    shape = {"net_arch": [32, 32], "log_std_init": -0.7}
    learner = PPO(
        "MlpPolicy",
        environments,
        n_steps=192,
        batch_size=256,
        learning_rate=2e-3,
        gamma=0.9,
        policy_kwargs=shape,
        seed=0,
        device="cpu",
        verbose=1,
    )
    learner.learn(steps)
    layers = [layer for layer in learner.policy.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    layers.append(learner.policy.action_net)
    arrays = [(layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in layers]
    return Mlp(tuple(W.astype(float) for W, _ in arrays), tuple(b.astype(float) for _, b in arrays))


if __name__ == "__main__":
    began = time.process_time()
    train(int(sys.argv[1]) if len(sys.argv) > 1 else STEPS).save(REACH)
    print(f"{REACH}: {REACH.stat().st_size} bytes after {time.process_time() - began:.0f} s of processor time")

"""Gymnasium wrappers that add faults to FailBench environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from failbench.fault.fault import Fault
from failbench.policies.gym.faulting import drawn_fault
from graceful_plan.array_types import Array
from graceful_plan.exceptions import SettingError
from graceful_plan.path import real_array
from graceful_plan.setting_checks import fraction


class WithFaults(gymnasium.Wrapper[Any, Array, Any, Array], gymnasium.utils.RecordConstructorArgs):
    """Draw a new fault in each episode, for example to train a robust policy.

    Args:
        env: A FailBench environment, wrapped or not.
        faults: Possible faults.
        healthy: Fraction of episodes without a fault, in [0, 1].
        shares: Relative frequency of each fault; equal if None.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Array],
        faults: Sequence[Fault],
        *,
        healthy: float = 0.5,
        shares: Sequence[float] | None = None,
    ) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, faults=faults, healthy=healthy, shares=shares)
        super().__init__(env)
        if not faults or not all(isinstance(fault, Fault) for fault in faults):
            raise SettingError("faults", tuple(faults), "at least one failbench.Fault, and nothing else")
        fraction("healthy", healthy, "a share in [0, 1]")
        weights = np.ones(len(faults)) if shares is None else real_array("shares", shares)
        if weights.shape != (len(faults),) or not (
            np.isfinite(weights).all() and (weights >= 0).all() and weights.any()
        ):
            raise SettingError("shares", shares, f"{len(faults)} finite numbers >= 0, not all of them 0")
        self._draws = np.random.default_rng()
        self._faults: list[Fault | None] = [None, *faults]
        self._shares = np.concatenate([[healthy], (1.0 - healthy) * weights / weights.sum()])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode with a newly drawn fault, or without one."""
        if seed is not None:
            self._draws = np.random.default_rng(seed)
        fault = drawn_fault(self._faults, self._shares.tolist(), self._draws)
        observed, info = self.env.reset(seed=seed, options={"fault": fault, **(options or {})})
        return observed, info | {"fault": "" if fault is None else f"{fault.NAME}/{fault.degree}"}

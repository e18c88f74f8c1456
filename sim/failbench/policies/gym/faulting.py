"""Faults in the episodes of environments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from failbench.fault.fault import Fault
from failbench.policies.task import PolicyTask
from failbench.recording.records import RolloutRequest
from graceful_plan.exceptions import SettingError
from graceful_plan.setting_checks import not_negative

_SEEDS = 2**53
_OPTIONS = ("fault", "onset")


class FaultSampler:
    """Draws onset and seed of a fault.

    Args:
        fault: Default fault; None for no fault. An episode's options override it.
    """

    def __init__(self, fault: Fault | None) -> None:
        self.fault = _checked(fault)

    def job(self, task: PolicyTask, rng: np.random.Generator, options: Mapping[str, Any]) -> RolloutRequest | None:
        """Return the fault of a new episode and its onset, by default within the duration of the straight motion.

        Args:
            task: The task.
            rng: Generator of the draws; their number does not depend on the fault.
            options: "fault" and "onset" of this episode.
        """
        if not isinstance(options, Mapping):
            raise SettingError("options", options, "a mapping")
        for name in options:
            if name not in _OPTIONS:
                raise SettingError("options", name, f"only {', '.join(_OPTIONS)}")
        u, seed = float(rng.random()), int(rng.integers(_SEEDS))
        fault = _checked(options.get("fault", self.fault))
        if fault is None:
            return None
        onset = options.get("onset", fault.when.onset(u, task.straight.duration))
        not_negative("onset", onset, "a finite time of at least 0 s")
        return RolloutRequest(fault=fault, onset=float(onset), seed=seed)


def _checked(fault: object) -> Fault | None:
    if fault is not None and not isinstance(fault, Fault):
        raise SettingError("fault", fault, "a failbench.Fault, or None")
    return fault


def drawn_fault(faults: Sequence[Fault | None], shares: Sequence[float], rng: np.random.Generator) -> Fault | None:
    """Draw a fault by the relative frequencies `shares`."""
    return faults[int(rng.choice(len(faults), p=np.asarray(shares) / np.sum(shares)))]

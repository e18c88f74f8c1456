"""What breaks in the episodes of environments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from failbench.fault.fault import Fault
from failbench.policies.task import PolicyTask
from failbench.recording.records import Job
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real

_SEEDS = 2**53
_OPTIONS = ("fault", "onset")


class Faulting:
    """Draws when a fault begins, and its seed.

    Args:
        fault: What breaks unless an episode's options say otherwise; None for nothing.
    """

    def __init__(self, fault: Fault | None) -> None:
        self.fault = _checked(fault)

    def job(self, task: PolicyTask, rng: np.random.Generator, options: Mapping[str, Any]) -> Job | None:
        """Return what breaks in an episode that begins, and when: while the straight motion would last, by default.

        Args:
            task: What is to be done.
            rng: Where the draws come from; there are as many whatever breaks.
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
        if not (is_real(onset) and 0.0 <= onset < np.inf):
            raise SettingError("onset", onset, "a finite time of at least 0 s")
        return Job(fault=fault, onset=float(onset), seed=seed)


def _checked(fault: object) -> Fault | None:
    if fault is not None and not isinstance(fault, Fault):
        raise SettingError("fault", fault, "a failbench.Fault, or None")
    return fault


def drawn_fault(faults: Sequence[Fault | None], shares: Sequence[float], rng: np.random.Generator) -> Fault | None:
    """Draw one of some faults by their shares."""
    return faults[int(rng.choice(len(faults), p=np.asarray(shares) / np.sum(shares)))]

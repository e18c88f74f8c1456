"""Onsets and random seeds of the rollouts of a trajectory.

The quantile and the seed of rollout i depend only on (seed, n), so comparisons use common random numbers. Onsets are
stratified. On request they are sampled more densely where the predicted impact is high, with importance weights.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from failbench.basics.onset import Onset
from failbench.fault.fault import Fault
from failbench.recording.records import RolloutRequest
from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_whole

Prediction = Callable[[Float[Array, " n"]], Float[Array, " n"]]
"""Returns the predicted impact of a failure at times after the start of a trajectory [s]; >= 0."""

MOST = 10_000_000
"""Greatest number of rollouts per call; their random numbers are kept in memory."""
MOST_THREADS = 1024
"""Greatest number of simulation threads, each with a copy of the scene's state."""
_CELLS = 512
"""Number of equally probable cells in which a proposal density is constant."""
_UNIFORM = 0.1
"""Fraction of the proposal that is uniform, whatever the prediction; weights are at most its inverse."""
_SEEDS = 2**53
"""Upper bound of seeds: JSON and floating-point columns hold integers below it exactly."""


class Draws(NamedTuple):
    """Random numbers of n rollouts, in the order of their quantiles."""

    quantile: Float[Array, " n"]
    """One in each of n equal strata of [0, 1)."""
    seed: Int[Array, " n"]


def draw(seed: int, n: int) -> Draws:
    """Draw the random numbers of n rollouts."""
    rng = np.random.default_rng([seed, n])
    return Draws((np.arange(n) + rng.random(n)) / n, rng.integers(_SEEDS, size=n))


def make_requests(
    faults: Sequence[Fault], duration: float, *, n: int, seed: int = 0, predicted: Prediction | None = None
) -> tuple[RolloutRequest, ...]:
    """Distribute rollouts over faults, evenly along a trajectory.

    Consecutive strata of onsets go to the faults in random order. Each fault therefore covers the whole trajectory, and
    no fault is systematically earlier than another.

    Args:
        faults: Faults, one per rollout.
        duration: Duration of the trajectory [s].
        n: Number of rollouts, rounded up to a multiple of the number of faults.
        seed: Seed of all random numbers.
        predicted: If given, onsets have the density 0.9 sqrt(predicted) + 0.1 relative to the fault's `when`, and the
            jobs carry the importance weights.
    """
    if not faults:
        raise SettingError("faults", tuple(faults), "at least one fault")
    check_whole("n", n, 1, MOST)
    check_whole("seed", seed, 0)
    rounds = -(-n // len(faults))
    draws = draw(seed, rounds * len(faults))
    order = np.random.default_rng([seed, n, len(faults)]).permuted(np.tile(np.arange(len(faults)), (rounds, 1)), axis=1)
    proposals = {fault.when: _proposal(fault.when, duration, predicted) for fault in faults}
    jobs = []
    for which, u, number in zip(order.ravel(), draws.quantile, draws.seed, strict=True):
        fault = faults[which]
        v, weight = proposals[fault.when].place(float(u))
        jobs.append(RolloutRequest(fault=fault, onset=fault.when.onset(v, duration), seed=int(number), weight=weight))
    return tuple(jobs)


def check_whole(name: str, value: object, least: int, most: int | None = None) -> None:
    """Raise SettingError unless `value` is a whole number from `least` to `most`."""
    if not is_whole(value) or value < least:
        raise SettingError(name, value, f"a whole number, at least {least}")
    if most is not None and value > most:
        raise SettingError(name, value, f"a whole number, at most {most}")


def thread_count(threads: int | None) -> int:
    """Return the number of threads, by default that of the cores.

    Raises:
        SettingError: If it is below 1 or above `MOST_THREADS`.
    """
    chosen = (os.cpu_count() or 1) if threads is None else threads
    check_whole("threads", chosen, 1, MOST_THREADS)
    return chosen


def quantile_grid(count: int = _CELLS) -> Float[Array, " cell"]:
    """Return the midpoints of equal cells of [0, 1]."""
    return (np.arange(count) + 0.5) / count


class _Proposal(NamedTuple):
    """A density over the onset's quantile, constant in equal cells, and its integral up to the start of each cell."""

    density: Float[Array, " cell"]
    cumulated: Float[Array, " cell"]

    def place(self, u: float) -> tuple[float, float]:
        """Return the quantile at which the integral of the density is `u`, and the weight there."""
        cell = int(np.searchsorted(self.cumulated, u, side="right")) - 1
        density = float(self.density[cell])
        v = (cell + (u - self.cumulated[cell]) * len(self.density) / density) / len(self.density)
        return min(float(v), 1.0), 1.0 / density


def _proposal(when: Onset, duration: float, predicted: Prediction | None) -> _Proposal:
    if predicted is None:
        return _Proposal(np.ones(1), np.zeros(1))
    times = np.array([when.onset(v, duration) for v in quantile_grid()])
    # For outcomes of 0 or 1, the optimal density is proportional to the square root of their probability.
    expected = predicted(times)
    if not (np.isfinite(expected).all() and expected.min() >= 0.0):
        raise SettingError("predicted", expected, "finite impacts >= 0")
    root = np.sqrt(expected)
    if not root.any():
        return _Proposal(np.ones(1), np.zeros(1))
    density = (1.0 - _UNIFORM) * root / root.mean() + _UNIFORM
    return _Proposal(density, np.concatenate([[0.0], np.cumsum(density[:-1]) / len(density)]))

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from failbench.basics.onset import AtFraction, AtTime, Uniform
from failbench.fault.fault import Fault
from failbench.rollouts.sampling import draw, make_requests
from failbench.simulated.simulation import Simulation
from graceful_plan.exceptions import SettingError


@dataclass(frozen=True, kw_only=True)
class Nothing(Fault):
    NAME: ClassVar[str] = "nothing"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "nothing at all"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.0, "moderate": 0.0, "severe": 0.0, "critical": 0.0}

    def apply(self, plant: Simulation, level: float) -> None:
        pass


DEGREES = ("minor", "moderate", "severe", "critical")


@given(st.integers(0, 2**40), st.integers(1, 300))
def test_one_quantile_falls_into_each_stratum(seed: int, n: int) -> None:
    draws = draw(seed, n)
    assert np.array_equal(np.floor(draws.quantile * n), np.arange(n))
    assert np.all((draws.seed >= 0) & (draws.seed < 2**53))
    assert len(set(draws.seed.tolist())) == n
    again = draw(seed, n)
    assert np.array_equal(draws.quantile, again.quantile)
    assert np.array_equal(draws.seed, again.seed)


def test_other_seeds_draw_other_numbers() -> None:
    assert not np.intersect1d(draw(0, 100).quantile, draw(1, 100).quantile).size
    assert not np.intersect1d(draw(0, 100).seed, draw(1, 100).seed).size


def test_random_numbers_are_common_to_trajectories_and_faults() -> None:
    faults = [Nothing(degree=degree) for degree in DEGREES]
    short, long = (make_requests(faults, duration, n=100, seed=3) for duration in (1.0, 7.0))
    assert [job.onset * 7.0 for job in short] == pytest.approx([job.onset for job in long])
    assert [(job.fault, job.seed) for job in short] == [(job.fault, job.seed) for job in long]
    others = make_requests([Nothing(degree="minor", ramp=0.1)] * 4, 1.0, n=100, seed=3)
    assert [(job.onset, job.seed) for job in others] == [(job.onset, job.seed) for job in short]


@given(st.integers(1, 5), st.integers(1, 60), st.integers(0, 1000))
def test_every_fault_has_the_whole_trajectory_in_even_strata(kinds: int, n: int, seed: int) -> None:
    faults = [Nothing(ramp=0.1 * i) for i in range(kinds)]
    jobs = make_requests(faults, 2.0, n=n, seed=seed)
    rounds = len(jobs) // kinds
    assert n <= len(jobs) < n + kinds
    for fault in faults:
        onsets = np.array([job.onset for job in jobs if job.fault == fault])
        assert np.array_equal(np.floor(onsets / 2.0 * rounds), np.arange(rounds))
    assert {job.weight for job in jobs} == {1.0}


def test_no_fault_always_has_the_earlier_onset() -> None:
    first = [make_requests([Nothing(), Nothing(ramp=1.0)], 1.0, n=2, seed=seed)[0].fault.ramp for seed in range(200)]
    assert 0.4 < np.mean(first) < 0.6


def test_onsets_follow_the_fault() -> None:
    faults = [
        Nothing(when=AtTime(0.5)),
        Nothing(when=AtTime(9.0)),
        Nothing(when=AtFraction(0.25)),
        Nothing(when=Uniform(0.5, 0.75)),
    ]
    jobs = make_requests(faults, 2.0, n=80, predicted=lambda t: t)
    onsets = [{job.onset for job in jobs if job.fault is fault} for fault in faults]
    assert onsets[:3] == [{0.5}, {2.0}, {0.5}]
    assert 1.0 <= min(onsets[3]) < 1.03
    assert 1.47 < max(onsets[3]) <= 1.5
    fixed = [job.weight for job in jobs if job.fault is not faults[3]]
    assert fixed == pytest.approx([1.0] * 60)


@pytest.mark.parametrize("duration", [1.0, 3.0])
def test_importance_sampling_is_unbiased(duration: float) -> None:
    fault = Nothing(when=Uniform(0.2, 1.0))
    jobs = make_requests(
        [fault], duration, n=4000, predicted=lambda t: (np.abs(t / duration - 0.5) < 0.1).astype(float)
    )
    t, w = np.array([job.onset for job in jobs]) / duration, np.array([job.weight for job in jobs])
    assert w.mean() == pytest.approx(1.0, abs=1e-2)
    for power in (1, 2, 5):  # the mean of t^k, uniform on [0.2, 1]
        exact = (1.0 - 0.2 ** (power + 1)) / (power + 1) / 0.8
        assert (w * t**power).mean() == pytest.approx(exact, rel=2e-2)
    inside = np.mean(np.abs(t - 0.5) < 0.1)
    assert inside == pytest.approx(0.9 + 0.1 * 0.25, abs=0.01)  # a quarter of the onsets
    assert w.max() <= 10.0 + 1e-9


def test_importance_sampling_needs_fewer_rollouts_where_the_prediction_is_right() -> None:
    rng, truth = np.random.default_rng(0), 0.1

    def spread(predicted) -> float:
        means = []
        for seed in range(200):
            jobs = make_requests([Nothing()], 1.0, n=40, seed=seed, predicted=predicted)
            hits = [(job.onset > 0.8) and rng.random() < 0.5 for job in jobs]
            means.append(np.mean([job.weight * hit for job, hit in zip(jobs, hits, strict=True)]))
        assert np.mean(means) == pytest.approx(truth, abs=0.01)
        return float(np.var(means))

    assert spread(lambda t: (t > 0.8).astype(float)) < 0.5 * spread(None)


def test_a_prediction_of_nothing_changes_nothing() -> None:
    assert make_requests([Nothing()], 1.0, n=9, predicted=np.zeros_like) == make_requests([Nothing()], 1.0, n=9)


def test_misuse_is_refused() -> None:
    with pytest.raises(SettingError, match="fault"):
        make_requests([], 1.0, n=10)
    with pytest.raises(SettingError, match="n = 0"):
        make_requests([Nothing()], 1.0, n=0)
    with pytest.raises(SettingError, match="seed = -1"):
        make_requests([Nothing()], 1.0, n=1, seed=-1)
    with pytest.raises(SettingError, match="impacts"):
        make_requests([Nothing()], 1.0, n=1, predicted=lambda t: -t)


def test_more_rollouts_than_there_is_memory_for_are_refused():
    with pytest.raises(SettingError, match="n = 1000000000000"):
        make_requests([Nothing()], 1.0, n=10**12)

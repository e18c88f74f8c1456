from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from failbench.calibrations import skill
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError

_EXACT = 1e-9
"""Relative; closed forms agree up to rounding."""

Array = np.ndarray


@st.composite
def events(draw: st.DrawFn) -> tuple[Array, Array]:
    n = draw(st.integers(10, 60))
    p = draw(hnp.arrays(float, n, elements=st.floats(0.0, 1.0)))
    y = draw(hnp.arrays(bool, n))
    return p, y


def _sample(n: int = 20_000, seed: int = 0) -> tuple[Array, Array]:
    """Draw events that happen exactly as often as predicted, with p uniform."""
    rng = np.random.default_rng(seed)
    p = rng.random(n)
    return p, rng.random(n) < p


@settings(deadline=None)  # the first call imports SciPy
@given(events())
def test_auc_is_the_share_of_pairs_in_the_right_order(data: tuple[Array, Array]) -> None:
    p, y = data
    pairs = [(a > b) + 0.5 * (a == b) for a in p[y] for b in p[~y]]
    if not pairs:
        assert math.isnan(skill.auc(p, y))
    else:
        assert skill.auc(p, y) == pytest.approx(np.mean(pairs), abs=_EXACT)


@given(events())
def test_certainty_and_the_base_rate(data: tuple[Array, Array]) -> None:
    _, y = data
    if y.all() or not y.any():
        assert math.isnan(skill.brier_skill(np.full(len(y), 0.5), y))
        return
    assert skill.brier_skill(y, y) == skill.auc(y, y) == skill.predicted_ratio(y, y) == 1.0
    assert skill.calibration_error(y, y, bins=1) == 0.0
    constant = np.full(len(y), y.mean())
    assert skill.brier_skill(constant, y) == pytest.approx(0.0, abs=_EXACT)
    assert skill.auc(constant, y) == 0.5


def test_calibrated_events_have_the_known_scores() -> None:
    p, y = _sample()
    # Of p uniform and y ~ Bernoulli(p): E (p-y)^2 = 1/6, base rate 1/2, log loss 1/2, AUC 5/6.
    assert skill.brier_skill(p, y) == pytest.approx(1.0 / 3.0, abs=0.02)
    assert skill.log_loss(p, y) == pytest.approx(0.5, abs=0.02)
    assert skill.auc(p, y) == pytest.approx(5.0 / 6.0, abs=0.01)
    assert skill.calibration_error(p, y) < 0.02
    assert skill.predicted_ratio(p, y) == pytest.approx(1.0, abs=0.03)


def test_figures_at_a_glance_are_the_same() -> None:
    p, y = _sample(500)
    found = skill.figures(p, y, bins=7)
    assert (found.events, found.happened) == (500, y.sum())
    for name in ("brier_skill", "auc", "log_loss"):
        assert getattr(found, name) == getattr(skill, name)(p, y)
    assert found.calibration_error == skill.calibration_error(p, y, 7)
    assert found.ratio == skill.predicted_ratio(p, y)


def test_calibration_error_of_overestimated_events() -> None:
    p, y = _sample()
    high = np.minimum(1.0, p + 0.2)
    # The excess is 0.2 up to p = 0.8 and 1 - p beyond: 0.16 + 0.02.
    assert skill.calibration_error(high, y) == pytest.approx(0.18, abs=0.01)


def test_log_loss_forgives_certainty_only_so_far() -> None:
    assert skill.log_loss([0.0], [True]) == pytest.approx(-math.log(skill.SMALLEST))
    assert skill.log_loss([0.5, 0.5], [True, False]) == pytest.approx(math.log(2.0))


def test_reliability_bands_cover_calibrated_predictions() -> None:
    p, y = _sample()
    clusters = np.arange(len(p)) % 200
    curve = skill.reliability(p, y, clusters, bins=12)
    assert curve.events.sum() == len(p)
    assert curve.events.max() - curve.events.min() <= 1
    assert (np.diff(curve.predicted) > 0.0).all()
    assert (curve.low <= curve.observed).all() and (curve.observed <= curve.high).all()
    inside = (curve.low <= curve.predicted) & (curve.predicted <= curve.high)
    assert inside.sum() >= 9


def test_bins_of_equal_hits() -> None:
    p, y = _sample()
    curve = skill.reliability(p, y, np.arange(len(p)), bins=8, by_hits=True, resamples=50)
    assert curve.events.sum() == len(p)
    assert np.allclose(curve.predicted * curve.events, p.sum() / 8, atol=1.5)
    assert (np.diff(curve.events) < 0).all()
    alike = skill.reliability(np.zeros(9), np.zeros(9), np.arange(9), bins=3, by_hits=True, resamples=50)
    assert alike.events.tolist() == [9]
    certain = skill.reliability(
        np.append(np.full(4, 0.1), np.ones(9)), np.ones(13), np.arange(13), bins=5, by_hits=True
    )
    assert certain.events.tolist() == [4, 9]


def test_bands_widen_if_events_of_a_motion_are_alike() -> None:
    p, _ = _sample(2000)
    rng = np.random.default_rng(1)
    clusters = np.arange(2000) // 100
    y = rng.random(20)[clusters] < p
    apart, together = (skill.reliability(p, y, c, bins=5) for c in (np.arange(2000), clusters))
    assert (together.high - together.low).mean() > 1.5 * (apart.high - apart.low).mean()


def test_bootstrap_intervals_are_repeatable_and_contain_the_figure() -> None:
    p, y = _sample(400)
    first = skill.bootstrap(skill.brier_skill, p, y, resamples=200)
    assert first == skill.bootstrap(skill.brier_skill, p, y, resamples=200)
    assert first.low < first.mean < first.high
    wide = skill.bootstrap(skill.brier_skill, p, y, np.arange(400) // 100, resamples=200)
    assert wide.n == 4


@pytest.mark.parametrize(
    ("p", "y", "error", "text"),
    [
        ([0.5, math.nan], [0, 1], NonFiniteError, "predicted"),
        ([0.5, 1.5], [0, 1], SettingError, "predicted"),
        ([0.5, 0.5], [0, 2], SettingError, "happened"),
        ([0.5], [0, 1], ShapeError, "observed"),
        ([], [], ShapeError, "at least one event"),
        ([[0.5]], [[1]], ShapeError, "predicted"),
    ],
)
def test_invalid_arguments_are_refused(p: list[float], y: list[float], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        skill.brier_skill(p, y)
    with pytest.raises(error, match=text):
        skill.auc(p, y)


def test_bins_are_at_most_as_many_as_events() -> None:
    with pytest.raises(SettingError, match="bins"):
        skill.calibration_error([0.1, 0.2], [0, 1], bins=3)
    with pytest.raises(ShapeError, match="clusters"):
        skill.reliability([0.1, 0.2], [0, 1], [1], bins=1)

"""Margins are found again in what they have made."""

import numpy as np
import pytest

from failbench.body_fit import fit_margin, predicted, wide
from graceful_plan import SettingError
from graceful_plan.costs.interactions.body import FAR
from graceful_plan.costs.interactions.body_constants import BodySettings, Margin
from graceful_plan.exceptions import ShapeError


@pytest.mark.parametrize("ways", [1, 3])
def test_a_margin_is_found_again(ways):
    rng = np.random.default_rng(ways)
    truth = Margin(offset=-0.04, spread=0.02)
    d = rng.uniform(-0.15, 0.3, size=(20_000, ways))
    hit = rng.uniform(size=len(d)) < predicted(d, truth)
    found = fit_margin(d, hit)
    assert found.offset == pytest.approx(truth.offset, abs=0.003)
    assert found.spread == pytest.approx(truth.spread, rel=0.08)
    assert predicted(d, found).mean() == pytest.approx(hit.mean(), rel=0.02)


def test_what_cannot_be_fitted():
    with pytest.raises(SettingError, match="hit"):
        fit_margin(np.zeros((3, 1)), np.zeros(3, dtype=bool))
    with pytest.raises(ShapeError, match="d has shape"):
        fit_margin(np.zeros((3, 1)), np.zeros(2, dtype=bool))


def test_wide_settings_cut_nothing_near():
    margin = wide(BodySettings.shipped()).stuck.body
    assert margin.offset + FAR * margin.spread == pytest.approx(0.35)

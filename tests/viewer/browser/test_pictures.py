"""Comparison of pictures: rendering differences of machines pass, missing content does not."""

from __future__ import annotations

import numpy as np
import pytest
from pictures import SIZE, STORED, UNLIKE, load, unlike

NAMES = sorted(file.stem for file in STORED.glob("*.png"))
ROBOT, CHART = (slice(58, 94), slice(85, 127)), (slice(82, 132), slice(188, 270))
"""Places of robot and chart in the picture "arm"."""


@pytest.fixture(scope="module")
def arm():
    return load("arm")


def test_stored_pictures_are_few_and_small():
    assert len(NAMES) == 3
    for name in NAMES:
        assert load(name).shape == (*SIZE[::-1], 3) and (STORED / f"{name}.png").stat().st_size < 40_000


def test_other_fonts_and_edges_pass(arm):
    lower = np.concatenate([arm[:3], arm[:-3]])
    blurred = (lower + np.roll(lower, 1, axis=0) + np.roll(lower, 1, axis=1) + np.roll(lower, -1, axis=1)) / 4.0
    noisy = np.clip(blurred + np.random.default_rng(0).normal(0.0, 0.05, arm.shape), 0.0, 1.0)
    assert unlike(arm, noisy) < 0.7 * UNLIKE


@pytest.mark.parametrize("place", [ROBOT, CHART])
def test_missing_and_additional_content_is_noticed(arm, place):
    without = arm.copy()
    without[place] = arm[place][0, 0]
    assert unlike(arm, without) > 1.5 * UNLIKE


def test_other_pictures_are_others():
    first, second, _ = map(load, NAMES)  # both show the arm, one with a failure
    assert unlike(first, second) > 1.5 * UNLIKE

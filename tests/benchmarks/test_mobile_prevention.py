"""Bound of `mobile_prevention`: the best of many motions, chosen on other failures than it is judged by."""

import numpy as np
import pytest
from benchmarks.subjects.mobile_prevention import Candidates, bound_table


def candidates(harm, duration=(1.0, 1.0, 1.0)):
    harm = np.array(harm)
    return Candidates(
        task="room/task",
        names=("w = 0", "default", "w = 1"),
        harm=harm,
        others=0.5 * np.nanmean(harm, axis=1),
        duration=np.array(duration),
    )


def test_the_best_motion_is_judged_by_failures_that_did_not_choose_it():
    lucky = candidates([[2.0, 2.0, 2.0, 2.0], [1.0, 1.0, 1.0, 1.0], [0.5, 4.0, 0.5, 4.0]])
    # The even failures choose the third motion, and the odd ones judge it; the odd ones choose the second.
    assert lucky.bound == pytest.approx(np.sqrt((2.0 / 4.0) * (2.0 / 1.0)))
    assert lucky.default_less == pytest.approx(2.0)
    assert lucky.chosen == "default"


def test_equal_motions_prevent_nothing():
    assert candidates(np.ones((3, 6))).bound == pytest.approx(1.0)


def test_motions_without_a_hit_count_a_tenth_of_one():
    harmless = candidates([[1.0] * 4, [0.0] * 4, [0.0] * 4], duration=(1.0, 2.0, 4.0))
    assert harmless.bound == pytest.approx(1.0 / (2.0 * 0.1 / 4 * 2.0))  # the shorter of the two


def test_diverged_simulations_do_not_count():
    assert candidates([[2.0, 2.0, 2.0, np.nan], [1.0] * 4, [3.0] * 4]).default_less == pytest.approx(2.0)


def test_the_table_names_the_motion_with_the_least_harm():
    text = bound_table([candidates([[2.0] * 4, [1.0] * 4, [0.5] * 4], duration=(1.0, 1.1, 1.2))])
    assert "| room/task | 3 | 2.00 | 4.00 | w = 1 | +20 % |" in text
    assert "| room/task | 2.00, 2.00, +10 % | 4.00, 4.00, +20 % |" in text

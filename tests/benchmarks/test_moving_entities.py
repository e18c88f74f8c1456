"""What nobody can tell about drops beside walkers, from drops that are repeated with other luck."""

import math
import sys

import numpy as np
import pytest
from places import ROOT

sys.path.insert(0, str(ROOT))

from benchmarks.subjects.moving_entities import Event, attainable


def events(P, rng, repeated=4):
    """Events that happen with some probabilities, each repeated."""
    drawn = rng.uniform(size=(len(P), repeated)) < np.asarray(P)[:, None]
    return [Event(task="", kind="", hit=bool(a), predicted=(), again=tuple(map(bool, more))) for a, *more in drawn]


@pytest.mark.parametrize("levels", [(0.0, 1.0), (0.3, 0.3), (0.1, 0.9), (0.0, 0.5)])
def test_attainable_is_the_skill_of_who_knows_the_probabilities(levels):
    rng = np.random.default_rng(0)
    P = rng.choice(levels, size=20_000)
    share = float(np.mean(levels))
    expected = 1.0 - float(np.mean([p * (1.0 - p) for p in levels])) / (share * (1.0 - share))
    assert attainable(events(P, rng)) == pytest.approx(expected, abs=0.02)


def test_without_hits_or_repetitions_nothing_is_said():
    rng = np.random.default_rng(0)
    assert math.isnan(attainable(events([0.0] * 5, rng)))
    assert math.isnan(attainable(events([0.5] * 5, rng, repeated=1)))

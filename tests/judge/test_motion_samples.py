"""Division of a motion into parts, on each of which no point moves far."""

from __future__ import annotations

import numpy as np
import pytest

from graceful_plan.judge.motion_samples import _subdivided  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize("seed", range(5))
def test_parts_are_even_no_longer_than_a_step_and_no_more_than_it_takes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends, moved = np.cumsum(rng.uniform(0.1, 1.0, 30)), rng.uniform(0.0, 0.4, 29)
    moved[[3, 7]] = 0.0, 0.1
    samples = _subdivided(ends, moved, 0.1)
    assert samples[0] == ends[0] and samples[-1] == ends[-1]
    for begin, end, way in zip(ends[:-1], ends[1:], moved, strict=True):
        assert {begin, end} <= {*samples.tolist()}
        inside = samples[(begin <= samples) & (samples <= end)]
        parts = max(1, int(np.ceil(way / 0.1)))
        np.testing.assert_allclose(inside, np.linspace(begin, end, parts + 1), atol=1e-12)

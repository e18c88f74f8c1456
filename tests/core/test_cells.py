"""The cell tree over obstacles skips no obstacle that is near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.array_types import Bool
from graceful_plan.core.arrays import BoundArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels

FEW = 4
"""Number of obstacles that always fit into one cell."""


@pytest.fixture(scope="module")
def crowd() -> gp.Scene:
    """A table surrounded by shapes of all kinds and sizes, and a plane."""
    rng = np.random.default_rng(3)
    sizes = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}
    solids = [
        gp.StaticBody(
            name=f"{kind}{k}",
            kind=kind,
            size=10.0 ** rng.uniform(-2.0, -1.0, count),
            pose=rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.2]),
        )
        for k in range(15)
        for kind, count in sizes.items()
    ]
    return gp.load_scene("tabletop_l1").edit(add=solids)


def _with(scene: gp.Scene, chosen: Bool[np.ndarray, " obstacle"], keep: float = 0.0) -> Kernels:
    """Kernels with only the chosen obstacles; every third obstacle has a required distance."""
    compiled = compile_scene(scene)
    world = compiled.world
    kept = keep * (np.arange(len(world.kind)) % 3 == 0)
    count = np.diff(world.hull_start)
    assert not count[chosen].any()  # no hulls: their triangles would have to be selected, too
    some = replace(
        world,
        **{name: getattr(world, name)[chosen] for name in ("kind", "pose", "size", "bound", "ignores", "geom")},
        hull_start=np.zeros(chosen.sum() + 1, dtype=world.hull_start.dtype),
    )
    bounds = replace(BoundArrays.none(len(world.kind)), keep=kept[chosen])
    return Kernels(compiled.robot, some, compiled.impact_tables, bounds=bounds)


@pytest.mark.parametrize("keep", [0.0, 0.03])
def test_a_crowd_is_as_near_as_its_nearest(crowd: gp.Scene, keep: float) -> None:
    n = len(compile_scene(crowd).world.kind)
    assert n > 60
    lower, upper = crowd.limits.position.T
    q = np.random.default_rng(4).uniform(lower, upper, (1000, 7))
    whole = _with(crowd, np.ones(n, dtype=bool), keep)
    parts = [_with(crowd, np.arange(n) // FEW == k, keep) for k in range(-(-n // FEW))]
    apart = np.array([part.clearance(q) for part in parts])
    assert len({int(k) for k in apart.argmin(axis=0)}) > 5
    np.testing.assert_allclose(whole.clearance(q), apart.min(axis=0), atol=2e-6)
    for margin in (0.0, 0.05):
        np.testing.assert_array_equal(whole.free(q, margin), np.all([p.free(q, margin) for p in parts], axis=0))
    ends = q[:-1], q[:-1] + 0.05 * (q[1:] - q[:-1])
    free = whole.edges_free(*ends)
    assert 0 < free.sum() < len(free)
    np.testing.assert_array_equal(free, np.all([part.edges_free(*ends) for part in parts], axis=0))
    value, gradient = whole.clearance_gradient(q)
    np.testing.assert_allclose(value, whole.clearance(q), atol=2e-6)
    assert np.isfinite(gradient).all()

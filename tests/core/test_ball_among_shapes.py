"""A ball on three slides next to single shapes: distances and gradients against known values and MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from ball import RADIUS, scene_of

from graceful_plan.core.arrays import BoundArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from sizes import first_quick

SOLIDS = {
    "sphere": 'type="sphere" size="0.2"',
    "capsule": 'type="capsule" size="0.15 0.2"',
    "cylinder": 'type="cylinder" size="0.2 0.22"',
    "box": 'type="box" size="0.2 0.25 0.3"',
}


def places(n: int, seed: int, size: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (n, 3))


@pytest.mark.parametrize("shape", SOLIDS)
def test_inside_an_obstacle_the_gradient_points_to_the_nearest_face(shape: str) -> None:
    kernels = compile_scene(scene_of(SOLIDS[shape])).kernels
    q = places(4000, 0, 0.4)
    clearance, gradient = kernels.clearance_gradient(q)
    within = clearance < -RADIUS - 0.01  # the ball's centre is inside the obstacle
    assert within.sum() > 100
    h = 5e-3
    gained = kernels.clearance(q[within] + h * gradient[within]) - clearance[within]
    assert np.mean(np.abs(gained - h) < 1e-5) > 0.95  # except where two faces are equally near


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_distances_to_blades_equal_those_of_mujoco(seed: int) -> None:
    """Thin hulls: at a sharp edge, one nearby point projects onto both faces."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.1, 0.3, 0.01], [0.2, 0.1, -0.02]])[rng.permutation(4)]
    vertices = " ".join(f"{x:.6g}" for x in corners.ravel())
    scene = scene_of('name="blade" type="mesh" mesh="blade"', f'<mesh name="blade" vertex="{vertices}"/>')
    ball, blade = scene.model.geom("ball").id, scene.model.geom("blade").id
    q = places(400, seed, 0.5)
    expected = np.array([mujoco.mj_geomDistance(scene.model, scene.data_at(x), ball, blade, 10.0, None) for x in q])
    got, outside = compile_scene(scene).kernels.clearance(q), expected > 1e-3
    np.testing.assert_allclose(got[outside], expected[outside], atol=2e-4)


@pytest.mark.parametrize("shape", SOLIDS)
def test_a_required_distance_counts_like_a_margin(shape: str) -> None:
    compiled = compile_scene(scene_of(SOLIDS[shape]))
    bounds = replace(BoundArrays.none(len(compiled.world.kind)), keep=np.full(len(compiled.world.kind), 0.07))
    kept = Kernels(compiled.robot, compiled.world, compiled.impact_tables, bounds=bounds)
    q = places(2000, 1, 0.6)
    plain = compiled.kernels.clearance(q)
    np.testing.assert_allclose(kept.clearance(q), plain - 0.07, atol=2e-6)
    certain = np.abs(plain - 0.07) > 1e-5
    assert 100 < np.sum(plain[certain] > 0.07) < 1900
    np.testing.assert_array_equal(kept.free(q)[certain], plain[certain] > 0.07)
    np.testing.assert_array_equal(kept.edges_free(q, q)[certain], plain[certain] > 0.07)


def test_no_obstacle_fits_between_two_samples_of_an_edge() -> None:
    """A contact longer than one step is found wherever it lies on the edge, and so is a contact at the end."""
    thin = 0.002
    kernels = compile_scene(scene_of(f'type="sphere" size="{thin}"')).kernels
    middle, reach = np.array([0.1, -0.05, 0.07]), RADIUS + thin
    rng = np.random.default_rng(2)
    for axis in range(3):
        q0, q1 = np.tile(middle, (400, 1)), np.tile(middle, (400, 1))
        q0[:, axis] -= rng.uniform(1.1 * reach, 0.9, 400)
        q1[:, axis] += rng.uniform(1.1 * reach, 0.9, 400)
        assert not kernels.edges_free(q0, q1, step=1.98 * reach).any()
        q1[:, axis] = middle[axis] - reach + 2e-5
        assert kernels.free(q0).all() and not kernels.free(q1).any()
        for a, b in ((q0, q1), (q1, q0)):
            assert not kernels.edges_free(a, b, step=0.5).any()
        q1[:, axis] = middle[axis] - reach - 2e-5
        assert kernels.edges_free(q0, q1, step=0.5).all()

"""Certified clearance: never above the true one, close to it, and uncertified stretches are reported."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.analysis.certified_clearance import ROUNDING, TOLERANCE, certified_clearance
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.path import Path
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.retiming import retime
from sizes import first_quick

Array = np.ndarray

_BALL = """
<mujoco>
  <worldbody>
    <body name="r/base">
      <body name="r/x"><joint name="r/x" type="slide" axis="1 0 0" range="-5 5"/>
        <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
        <body name="r/y"><joint name="r/y" type="slide" axis="0 1 0" range="-5 5"/>
          <geom name="r/ball" type="sphere" size="0.1" mass="1"/>
          <site name="r/tool"/>
        </body>
      </body>
    </body>
    <body name="thing">{}</body>
  </worldbody>
</mujoco>
"""
_SPHERE = '<geom name="thing" type="sphere" size="0.2"/>'
_WALL = '<geom name="thing" type="box" size="0.0005 5 5"/>'

_HINGE = """
<mujoco>
  <worldbody>
    <body name="r/base">
      <body name="r/arm"><joint name="r/turn" axis="0 0 1" range="-3 3"/>
        <geom name="r/ball" type="sphere" size="0.05" pos="1 0 0" mass="1"/>
        <site name="r/tool" pos="1 0 0"/>
      </body>
    </body>
    <body name="thing" pos="1.2 0 0"><geom name="thing" type="sphere" size="0.1"/></body>
  </worldbody>
</mujoco>
"""


_MIXED = """
<mujoco>
  <worldbody>
    <body name="r/base">
      <body name="r/a"><joint name="r/a" axis="0 0 1" range="-3 3"/>
        <geom name="r/a" type="capsule" size="0.04" fromto="0 0 0 0.4 0 0" mass="1"/>
        <body name="r/b" pos="0.4 0 0"><joint name="r/b" type="slide" axis="1 0 0" range="0 0.4"/>
          <geom name="r/b" type="sphere" size="0.05" mass="1"/>
          <body name="r/c" pos="0.1 0 0"><joint name="r/c" axis="0 1 0" range="-2 2"/>
            <geom name="r/c" type="capsule" size="0.03" fromto="0.08 0 0 0.5 0 0" mass="1"/>
            <site name="r/tool" pos="0.5 0 0"/>
          </body>
        </body>
      </body>
    </body>
    <body name="thing" pos="0.7 0.7 0.2"><geom name="thing" type="sphere" size="0.15"/></body>
    <body name="board" pos="0.5 -0.6 0"><geom name="board" type="box" size="0.3 0.02 0.3"/></body>
  </worldbody>
</mujoco>
"""


def _scene(mjcf: str, joints: int) -> Scene:
    velocity, acceleration = [1.0] * joints, [5.0] * joints
    return Scene.from_mjcf(mjcf, robot="r/", tool="r/tool", velocity=velocity, acceleration=acceleration)


@cache
def _kernels(mjcf: str, joints: int) -> Kernels:
    return compile_scene(_scene(mjcf, joints)).kernels


@pytest.fixture(scope="module")
def tabletop() -> Scene:
    return load_scene("tabletop").tasks["green_to_blue"].scene


def _exact_clearance(scene: Scene, q: Array) -> float:
    """Return the least MuJoCo distance between geoms that must not touch [m]."""
    least = np.inf
    for configuration in q:
        data = scene.data_at(configuration)
        for a, b in scene.collision_pairs():
            least = min(least, mujoco.mj_geomDistance(scene.model, data, int(a), int(b), 0.3, None))
    return least


@given(offset=st.floats(0.31, 1.0), start=st.floats(-3.0, -0.7), end=st.floats(0.7, 3.0))
def test_a_ball_passes_a_ball_at_a_known_distance(offset: float, start: float, end: float):
    found = certified_clearance(Path(np.array([[start, offset], [end, offset]])), _kernels(_BALL.format(_SPHERE), 2))
    true = offset - 0.3
    assert true - min(TOLERANCE, true) - 2.0 * ROUNDING <= found.bound <= true + 1e-9
    assert not found.uncertified


def test_a_lever_sweeps_past_a_ball_at_a_known_distance():
    found = certified_clearance(Path(np.array([[-1.3], [1.1]])), _kernels(_HINGE, 1))
    assert 0.05 - TOLERANCE - 2.0 * ROUNDING <= found.bound <= 0.05


def test_a_wall_thinner_than_the_samples_are_apart_is_found():
    path = Path(np.array([[-1.0, 0.0], [0.73, 0.0]]))
    found = certified_clearance(path, _kernels(_BALL.format(_WALL), 2))
    assert found.bound < 0.0
    ((first, last),) = found.uncertified
    # Contact from -0.1005 to 0.1005 m; the first is 0.8995 rad into the path.
    assert first <= 0.8995 <= first + 1e-3 and last >= 1.1005 >= last - 1e-3


def test_every_stretch_in_contact_is_named():
    there_and_back = Path(np.array([[-1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]]))
    found = certified_clearance(there_and_back, _kernels(_BALL.format(_SPHERE), 2))
    assert len(found.uncertified) == 2
    assert np.allclose(found.uncertified, [[0.7, 1.3], [2.7, 3.3]], atol=2e-3)


def test_nothing_to_hit_is_infinitely_far():
    scene = _scene(_BALL.format('<geom name="thing" type="sphere" size="0.2" contype="0" conaffinity="0"/>'), 2)
    found = certified_clearance(Path(np.array([[-1.0, 0.0], [1.0, 0.0]])), compile_scene(scene).kernels)
    assert found.bound == np.inf and not found.uncertified


def test_a_path_of_one_configuration():
    kernels = _kernels(_BALL.format(_SPHERE), 2)
    found = certified_clearance(Path(np.array([[1.0, 0.0]])), kernels)
    assert found.bound == pytest.approx(0.7, abs=1e-4)
    inside = certified_clearance(Path(np.array([[0.1, 0.0], [0.1, 0.0]])), kernels)
    assert inside.uncertified == ((0.0, 0.0),)


@pytest.mark.parametrize("seed", first_quick(range(6)))
def test_random_paths_of_the_arm_are_never_nearer_than_certified(tabletop: Scene, seed: int):
    rng = np.random.default_rng(seed)
    kernels = compile_scene(tabletop).kernels
    lower, upper = tabletop.limits.position.T
    vertices = rng.uniform(lower, upper, size=(200, len(lower)))
    path = Path(vertices[np.argsort(-kernels.clearance(vertices))[: rng.integers(2, 5)]])
    found = certified_clearance(path, kernels)
    dense = kernels.clearance(path.resampled(path.length / 3000).q)
    assert found.bound <= float(dense.min()) <= found.sampled + 1e-3
    # The kernels' clearance is a lower bound only where it is positive.
    exact = _exact_clearance(tabletop, path.resampled(path.length / 150).q)
    assert found.bound <= max(exact, 0.0) + 1e-6
    assert (found.bound < 0.0) == bool(found.uncertified)
    if found.bound >= 0.0:
        assert found.bound >= found.sampled - TOLERANCE - 2.0 * ROUNDING


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_chains_of_hinges_and_slides(seed: int):
    rng = np.random.default_rng(seed)
    kernels = _kernels(_MIXED, 3)
    path = Path(rng.uniform([-2.5, 0.0, -2.0], [2.5, 0.4, 2.0], size=(3, 3)))
    found = certified_clearance(path, kernels)
    dense = float(kernels.clearance(path.resampled(path.length / 2000).q).min())
    assert found.bound <= dense + 1e-9
    assert dense > 0.0 or found.uncertified


def test_trajectories_cut_corners_and_are_certified_along_the_cut(tabletop: Scene):
    kernels = compile_scene(tabletop).kernels
    q = np.stack([tabletop.keyframes[name] for name in ("right", "far", "left")])
    trajectory = retime(Path(q), tabletop.limits, tabletop.joints, deviation=0.1)
    found = certified_clearance(trajectory, kernels)
    dense = kernels.clearance(trajectory.sample(trajectory.duration / 5000).q)
    assert found.bound <= float(dense.min()) <= found.sampled + 1e-3
    delayed = certified_clearance(trajectory.delayed(1.5), kernels)
    assert delayed.bound == pytest.approx(found.bound, abs=TOLERANCE)


def test_the_effort_is_bounded(tabletop: Scene):
    q = np.stack([tabletop.keyframes[name] for name in ("right", "left")])
    found = certified_clearance(Path(q), compile_scene(tabletop).kernels, tolerance=1e-9, most=500)
    assert found.evaluations < 1500
    assert found.bound <= found.sampled

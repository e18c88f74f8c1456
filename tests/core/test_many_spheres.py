"""Links with many spheres, where clusters are pruned separately for each configuration, against all pairs."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.compile import CompiledScene, compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets

_FLOAT32 = 2e-6
"""Metres: collision runs in single precision."""
_BOXES = """
<mujoco><compiler angle="radian" autolimits="true"/>
<custom><numeric name="arm/velocity_limit" data="1 1 1 1"/><numeric name="arm/acceleration_limit" data="1 1 1 1"/>
</custom>
<worldbody>
  <geom name="ground" type="plane" size="2 2 .1" pos="0 0 -.2"/>
  <geom name="ball" type="sphere" size=".12" pos=".4 .2 .3"/>
  <body name="arm/base"><geom type="box" size=".1 .1 .05"/>
    <body name="arm/a" pos="0 0 .2"><joint name="a" axis="0 0 1" range="-3 3"/><geom type="box" size=".06 .05 .12"/>
      <body name="arm/b" pos="0 .12 .1"><joint name="b" axis="0 1 0" range="-3 3"/>
        <geom type="box" size=".05 .05 .2" pos="0 0 .15"/>
        <body name="arm/c" pos="0 -.12 .35"><joint name="c" axis="0 1 0" range="-3 3"/>
          <geom type="box" size=".05 .04 .2" pos="0 0 .15"/>
          <body name="arm/d" pos="0 .1 .3"><joint name="d" axis="0 1 0" range="-3 3"/>
            <geom type="box" size=".08 .04 .08" pos="0 0 .1"/><site name="arm/tool"/>
  </body></body></body></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def compiled() -> CompiledScene:
    return compile_scene(gp.Scene.from_mjcf(_BOXES, robot="arm/", tool="arm/tool"))


@pytest.fixture(scope="module", params=[3.0, 0.02], ids=["apart", "together"])
def sampled(compiled: CompiledScene, request: pytest.FixtureRequest) -> tuple[np.ndarray, np.ndarray]:
    """Configurations, spread out or close together, and their clearance over all pairs."""
    rng, spread = np.random.default_rng(1), request.param
    q = np.clip(rng.uniform(-2.5, 2.5, 4) * (spread < 1.0) + rng.uniform(-spread, spread, (70, 4)), -3.0, 3.0)
    return q, _all_pairs(compiled, q)


def _all_pairs(compiled: CompiledScene, q: np.ndarray) -> np.ndarray:
    """Return the clearance over all sphere pairs of links, and to ground and ball."""
    robot = compiled.robot
    X = compiled.kernels.link_poses(q)[:, robot.sphere_link]
    p = np.einsum("nsij,sj->nsi", X[..., :3, :3], robot.sphere[:, :3]) + X[..., :3, 3]
    r = robot.sphere[:, 3]
    of = [np.flatnonzero(robot.sphere_link == link) for link in range(len(robot.parent))]
    least = np.full(len(q), np.inf)
    for (a, b), slack in zip(robot.self_pair, robot.self_slack, strict=True):
        gap = np.linalg.norm(p[:, of[a], None] - p[:, None, of[b]], axis=3) - r[of[a], None] - r[of[b]] - slack
        least = np.minimum(least, gap.min(axis=(1, 2), initial=np.inf))
    moving = np.flatnonzero(_frames(robot)[robot.sphere_link] > 0)
    for away in (p[..., 2] + 0.2, np.linalg.norm(p - [0.4, 0.2, 0.3], axis=2) - 0.12):
        least = np.minimum(least, (away - r)[:, moving].min(axis=1))
    return least


def _frames(robot: RobotArrays) -> np.ndarray:
    frame = np.arange(len(robot.parent))
    for link in range(1, len(frame)):
        if robot.joint[link] < 0:
            frame[link] = frame[robot.parent[link]]
    return frame


@pytest.mark.parametrize("isa", instruction_sets())
def test_clearance_and_free_equal_those_over_all_pairs(
    compiled: CompiledScene, isa: str, sampled: tuple[np.ndarray, np.ndarray]
) -> None:
    robot = compiled.robot
    assert np.bincount(robot.sphere_link).max() > 24  # several clusters
    q, expected = sampled
    kernels = Kernels(robot, compiled.world, compiled.impact_tables, isa)
    np.testing.assert_allclose(kernels.clearance(q), expected, atol=_FLOAT32)
    np.testing.assert_array_equal(kernels.clearance(q), [kernels.clearance(one) for one in q])
    for margin in (0.0, 0.03, -0.02):
        sure = np.abs(expected - margin) > _FLOAT32
        np.testing.assert_array_equal(kernels.free(q, margin)[sure], (expected >= margin)[sure])


def test_the_gradient_belongs_to_the_nearest_pair(compiled: CompiledScene) -> None:
    q = np.random.default_rng(2).uniform(-2.9, 2.9, (8, 4))
    clearance, gradient = compiled.kernels.clearance_gradient(q)
    np.testing.assert_allclose(clearance, _all_pairs(compiled, q), atol=_FLOAT32)
    step, smooth = 1e-6, 0
    for k in range(4):
        ahead, behind = (_all_pairs(compiled, q + s * step * np.eye(4)[k]) for s in (1.0, -1.0))
        slope, bent = (ahead - behind) / (2.0 * step), np.abs(ahead + behind - 2.0 * clearance) > 3e-6
        np.testing.assert_allclose(gradient[~bent, k], slope[~bent], atol=1e-3)
        smooth += int((~bent).sum())
    assert smooth > 20

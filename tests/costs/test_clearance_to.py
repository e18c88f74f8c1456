"""Clearance of states to one target: NumPy twin, MuJoCo's distances, differences, and `ClearanceCost`."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.testing import check_cost
from support.costs.clearance_twin import ClearanceTwin

_ROUNDING = 2e-6  # [m]; the kernels compute distances in single precision
_FARTHEST = 10.0  # [m]; cutoff of MuJoCo's distances
_STICKS_OUT = 0.01  # [m]; covering spheres exceed the links by less than this, see `gp.clearance`
THINGS = ("surroundings", "self", "laptop")

_CART = """<mujoco model="cart"><worldbody>
  <body name="cart/x"><joint name="cart/x" type="slide" axis="1 0 0" range="-1 1"/>
    <geom type="sphere" size=".05" mass="1"/><site name="cart/tool"/></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def scene() -> gp.Scene:
    return gp.load_scene("desk").tasks["bring_coffee"].scene


def test_the_twin_of_the_clearance_agrees_with_the_kernels():
    kernels = compile_scene(gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene).kernels
    twin = ClearanceTwin(kernels.robot, kernels.world)
    q = np.random.default_rng(0).uniform(kernels.robot.lower, kernels.robot.upper, (60, kernels.nq))
    distances = twin.distances(q)
    np.testing.assert_allclose(distances.min(axis=1), kernels.clearance(q), atol=1e-5)
    nearest = distances.argmin(axis=1)
    assert np.any(nearest >= distances.shape[1] - twin.n_self) and np.any(nearest < distances.shape[1] - twin.n_self)
    np.testing.assert_allclose(twin.distance(q, nearest), distances.min(axis=1), atol=1e-12)


@pytest.fixture(scope="module")
def q(scene: gp.Scene) -> np.ndarray:
    return np.random.default_rng(0).uniform(*scene.limits.position.T, size=(60, len(scene.joints)))


def _distances(scene: gp.Scene, to: str, q: np.ndarray) -> np.ndarray:
    """Return the distance of every relevant pair [n, pair], by the twin."""
    compiled = compile_scene(scene)
    twin = ClearanceTwin(compiled.robot, compiled.world)
    found = twin.distances(q)
    if to == "self":
        return found[:, -twin.n_self :]
    chosen = _moves(compiled.robot)[compiled.robot.sphere_link[twin.sphere]]  # the fixed base is ignored
    if to != "surroundings":
        chosen &= np.isin(compiled.world.geom[twin.obstacle], scene.entities[to].geoms)
    return found[:, : -twin.n_self][:, chosen]


def _moves(robot: RobotArrays) -> np.ndarray:
    """Return which links move with some joint."""
    moves = robot.joint >= 0
    for link, parent in enumerate(robot.parent):
        moves[link] |= parent >= 0 and moves[parent]
    return moves


@pytest.mark.parametrize("to", THINGS)
def test_the_clearance_is_that_of_the_nearest_pair(scene: gp.Scene, q: np.ndarray, to: str) -> None:
    found = gp.StateBatch(scene, q).clearance_to(to)
    expected = _distances(scene, to, q).min(axis=1)
    assert (found <= expected + _ROUNDING).all()
    assert np.mean(found >= expected - _ROUNDING) > 0.95  # elsewhere an ellipsoid is nearest, which the twin leaves out


@pytest.mark.parametrize("to", THINGS)
def test_the_gradient_equals_differences(scene: gp.Scene, q: np.ndarray, to: str) -> None:
    found, h = gp.StateBatch(scene, q).clearance_gradient_to(to), 1e-6
    assert np.abs(found).max() > 0.1
    for j, e in enumerate(h * np.eye(q.shape[1])):
        up, down = (_distances(scene, to, q + side).min(axis=1) for side in (e, -e))
        error = np.abs(found[:, j] - (up - down) / (2.0 * h))
        assert np.mean(error < 1e-3) > 0.95, np.sort(error)[-6:]  # elsewhere the nearest pair changes


def test_all_is_the_least_of_surroundings_and_self(scene: gp.Scene, q: np.ndarray) -> None:
    batch = gp.StateBatch(scene, q)
    outside, own = batch.clearance_to("surroundings"), batch.clearance_to("self")
    np.testing.assert_array_equal(np.minimum(outside, own), batch.clearance)
    assert (outside > own).any() and (own > outside).any()
    assert (batch.clearance_to("laptop") >= outside).all()


def test_clearance_to_an_entity_is_at_most_mujocos_and_close_to_it(scene: gp.Scene, q: np.ndarray) -> None:
    """The spheres exceed the arm slightly, so the distance is never larger and almost as large."""
    found = gp.StateBatch(scene, q).clearance_to("laptop")
    theirs, moves = set(scene.entities["laptop"].geoms), scene.model.body_weldid[scene.model.geom_bodyid] > 0
    both_ways = np.vstack([scene.collision_pairs(), scene.collision_pairs()[:, ::-1]]).tolist()
    pairs = [(mine, other) for mine, other in both_ways if moves[mine] and mine not in theirs and other in theirs]
    assert len(pairs) > 5
    for row, clearance in zip(q, found, strict=True):
        data = scene.data_at(row)
        true = min(mujoco.mj_geomDistance(scene.model, data, a, b, _FARTHEST, None) for a, b in pairs)
        if true > 0.0:
            assert true - _STICKS_OUT < clearance <= true + _ROUNDING


def test_the_clearance_is_computed_once(scene: gp.Scene, q: np.ndarray) -> None:
    batch = gp.StateBatch(scene, q)
    assert batch.clearance_to("self") is batch.clearance_to("self")
    assert batch.clearance_gradient_to("self") is batch.at(np.zeros(len(q))).clearance_gradient_to("self")


def test_nothing_to_hit_is_infinitely_far() -> None:
    scene = gp.Scene.from_mjcf(_CART, robot="cart/", tool="cart/tool", velocity=[1.0], acceleration=[2.0])
    batch = gp.StateBatch(scene, np.zeros((3, 1)))
    assert np.isposinf(batch.clearance_to("surroundings")).all()
    np.testing.assert_array_equal(batch.clearance_gradient_to("surroundings"), np.zeros((3, 1)))


def test_unknown_things_are_named(scene: gp.Scene, q: np.ndarray) -> None:
    batch = gp.StateBatch(scene, q)
    for ask in (batch.clearance_to, batch.clearance_gradient_to):
        with pytest.raises(UnknownNameError, match=r"'lamp'; valid: .*laptop.*self, stapler, surroundings"):
            ask("lamp")


@dataclass(frozen=True)
class Near(gp.Cost):
    """Run the example of docs/costs.md."""

    distance: float = 0.05

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        return np.maximum(0.0, 1.0 - batch.clearance_to("surroundings") / self.distance)

    def gradient(self, batch: gp.StateBatch) -> np.ndarray:
        near = batch.clearance_to("surroundings") < self.distance
        return np.where(near[:, None], -batch.clearance_gradient_to("surroundings") / self.distance, 0.0)


def test_a_custom_cost_equals_the_block(scene: gp.Scene, q: np.ndarray) -> None:
    own, block, batch = Near(0.1), gp.ClearanceCost(0.1), gp.StateBatch(scene, q)
    check_cost(own, scene)
    assert 0.1 < np.mean(own.state(batch) > 0.0) < 0.9
    np.testing.assert_allclose(own.state(batch), block.state(batch), atol=_ROUNDING / own.distance)
    np.testing.assert_allclose(own.gradient(batch), block.gradient(batch), atol=1e-4)

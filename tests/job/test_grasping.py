"""Sampled grasps hold the object by the machinery of `GraspHolds`, and agree with closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from grippers import CUP, JAW, JAW_DRIVE, SLIDES, armed, linkage

import graceful_plan as gp
from graceful_plan.constraints.grasp import GraspHolds
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError
from graceful_plan.job.gripper import find_gripper
from graceful_plan.scene.rules.grip import find_grip
from graceful_plan.scene.scene import Scene

_CUBE = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (-0.03, 0.03)])
_BLOCK = 0.04
"""Width of the block of `armed` [m]."""
_MESH_ROUNDING = 1e-6
"""Vertices of meshes are single precision [m]."""


@pytest.fixture(scope="module")
def tabletop() -> Scene:
    return gp.load_scene("tabletop")


def test_the_gripper_is_that_of_the_model(tabletop: Scene) -> None:
    gripper = find_gripper(tabletop)
    np.testing.assert_allclose(gripper.closing, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(gripper.approach, [0.0, 0.0, 1.0], atol=1e-12)
    assert gripper.range == pytest.approx((0.0, 0.08), abs=1e-4)  # the pads overlap by 0.04 mm when closed
    assert gripper.fingers(0.05) == pytest.approx({"panda/finger_joint2": 0.025}, abs=1e-4)


def test_a_cube_is_held_from_above_and_from_the_sides_by_the_weight_over_friction(tabletop: Scene) -> None:
    found = gp.grasps(tabletop, "white1", n=24)
    tilts = {round(float(grasp.approach[2]), 1) for grasp in found}
    assert {-1.0, -0.7, 0.0} <= tilts
    central = [g for g in found if np.linalg.norm(np.linalg.inv(g.X_TO)[:3, 3]) < 1e-3]
    grip = find_grip(tabletop.attach("white1", X_TO=central[0].X_TO, fingers=central[0].fingers))
    weight = grip.mass * 9.81
    np.testing.assert_allclose(central[0].quality, 1.0 - weight / (grip.friction * grip.force), rtol=0.02)


@pytest.mark.parametrize("name", ["bottle", "teapot", "pan"])
def test_grasps_keep_the_constraint_and_have_the_width_between_the_pads(name: str) -> None:
    scene = gp.load_scene("dining_table")
    found = gp.grasps(scene, name, n=6, seed=3)
    np.testing.assert_allclose(found[0].X_TO, scene.attach(name).carried.X_TO)  # the declared one is the first
    for grasp in found[1:]:
        held = scene.attach(name, X_TO=grasp.X_TO, fingers=grasp.fingers)
        grip = GraspHolds().grip(held)
        (finger,) = grasp.fingers.values()
        assert 2.0 * grip.half[0] == pytest.approx(2.0 * finger, abs=2e-4)
        assert 0.05 <= grasp.quality <= 1.0 and grasp.opening > 2.0 * finger


@pytest.mark.parametrize("scene", [linkage(), armed(SLIDES)], ids=["linkage", "mirrored slides"])
def test_other_grippers_hold_by_their_pads(scene: Scene) -> None:
    gripper = find_gripper(scene)
    found = gp.grasps(scene, "block", n=6)
    assert len(found) == 6
    for grasp in found:
        held = scene.attach("block", X_TO=grasp.X_TO, fingers=grasp.fingers)
        assert 2.0 * find_grip(held).half[0] == pytest.approx(_BLOCK, abs=2e-4)
        assert grasp.quality > 0.9 and grasp.opening == pytest.approx(_BLOCK + 0.02)
        assert gripper.range[0] < _BLOCK < grasp.opening < gripper.range[1]


@pytest.mark.parametrize(
    ("scene", "why"), [(armed(CUP), "no joint"), (armed(JAW, drive=JAW_DRIVE), "is fixed")], ids=["cup", "jaw"]
)
def test_grippers_without_two_pads_that_move_need_given_grasps(scene: Scene, why: str) -> None:
    with pytest.raises(UnsupportedError, match=why):
        gp.grasps(scene, "block")


def test_a_mesh_is_grasped_like_the_primitive_it_equals(tabletop: Scene) -> None:
    scene = tabletop.add_mesh("block", _CUBE, [0.0, 0.35, 0.43])
    found = gp.grasps(scene, "block", n=8)
    assert len(found) == 8
    for grasp in found:
        (finger,) = grasp.fingers.values()
        assert finger == pytest.approx(0.03, abs=1e-4 + _MESH_ROUNDING)


def test_grasps_turn_with_the_object(tabletop: Scene) -> None:
    X = np.eye(4)
    X[:2, :2], X[:3, 3] = [[0.6, -0.8], [0.8, 0.6]], [0.1, -0.25, 0.43]
    turned = tabletop.edit(move={"white4": X})
    one, other = (np.stack([g.X_TO for g in gp.grasps(s, "white4", n=400)]) for s in (tabletop, turned))
    away = np.abs(one[:, None] - other[None]).max(axis=(2, 3))
    assert (away.min(axis=0) < 1e-6).all() and (away.min(axis=1) < 1e-6).all()


def test_what_is_wider_than_the_gripper_has_no_grasp(tabletop: Scene) -> None:
    scene = tabletop.add_box("crate", [0.1, 0.1, 0.1], [0.0, 0.4, 0.1])
    assert gp.grasps(scene, "crate") == ()


def test_misuse_is_named(tabletop: Scene) -> None:
    with pytest.raises(UnknownNameError, match="valid"):
        gp.grasps(tabletop, "kettle")
    with pytest.raises(SettingError, match="at least 1"):
        gp.grasps(tabletop, "green", n=0)
    with pytest.raises(SettingError, match="direction"):
        gp.Grasp(X_TO=np.eye(4), approach=np.zeros(3))

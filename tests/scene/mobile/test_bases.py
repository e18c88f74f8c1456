from dataclasses import replace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError
from hall import BASE, hall

SCENE_FILE = """
version: 1
world: world.xml
robot: {prefix: cart/}
base: {joints: [cart/x, cart/y, cart/yaw], radius: 0.1, track: 0.4, v_max: 1, omega_max: 2, a_max: 1, alpha_max: 3EXTRA}
tool: cart/base
"""
WORLD = """
<mujoco><worldbody><body name="cart/base">
  <joint name="cart/x" type="slide" axis="1 0 0" range="-8 8"/>
  <joint name="cart/y" type="slide" axis="AXIS" range="-8 8"/>
  <joint name="cart/yaw" type="hinge" axis="0 0 1"/>
  <geom type="box" size=".2 .2 .1" pos="0 0 .2"/>
</body></worldbody></mujoco>
"""


def load(folder, extra="", axis="0 1 0"):
    (folder / "world.xml").write_text(WORLD.replace("AXIS", axis))
    (folder / "scene.yaml").write_text(SCENE_FILE.replace("EXTRA", extra))
    return gp.load_scene(folder / "scene.yaml")


def test_limits_of_the_joints_are_those_of_the_base():
    limits = hall().limits
    np.testing.assert_allclose(limits.velocity, [2.0, 2.0, 4.0])
    np.testing.assert_allclose(limits.acceleration, [np.hypot(2.0, 2.0), np.hypot(2.0, 2.0), 6.0])
    assert limits.position[2].tolist() == [-4 * np.pi, 4 * np.pi]
    assert hall(arm=True).limits.velocity[3] == 1.5


def test_scene_files_have_bases(tmp_path):
    base = load(tmp_path, ", reverse: false, slip: 1.5").base
    assert base == gp.DiffDrive(
        joints=("cart/x", "cart/y", "cart/yaw"), radius=0.1, track=0.4, slip=1.5, v_max=1.0, omega_max=2.0, a_max=1.0,
        alpha_max=3.0, reverse=False,
    )  # fmt: skip
    assert base.wheel_max == pytest.approx(10.0) and base.lever == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("extra", "message"),
    [(", slip: 0.5", "slip"), (", reverse: maybe", "true or false"), (", colour: red", "colour")],
)
def test_broken_bases_are_refused_with_their_line(tmp_path, extra, message):
    with pytest.raises(SceneError, match=message) as caught:
        load(tmp_path, extra)
    assert caught.value.line == 5


def test_joints_have_to_be_those_of_a_plane(tmp_path):
    with pytest.raises(SceneError, match="cart/y"):
        load(tmp_path, axis="0 0 1")


@pytest.mark.parametrize(
    "name", ["radius", "track", "v_max", "omega_max", "a_max", "alpha_max", "lateral_max", "wheel_max"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_numbers_of_a_base_are_checked(name, value):
    with pytest.raises(SettingError, match=name):
        replace(BASE, **{name: value})


def test_joints_are_looked_up():
    with pytest.raises(UnknownNameError, match="cart/z"):
        hall(replace(BASE, joints=("cart/x", "cart/y", "cart/z")))
    with pytest.raises(SceneError, match="first planned"):
        hall(replace(BASE, joints=("cart/y", "cart/x", "cart/yaw")))


@pytest.mark.parametrize("given", [(np.nan, 0.0), (0.0, 0.0, np.inf), (-np.inf, 0.0)])
def test_poses_of_a_base_are_finite_numbers(given):
    with pytest.raises(SettingError, match="BasePose"):
        gp.BasePose(*given)


@pytest.mark.parametrize("name", ["radius", "track", "slip", "v_max", "omega_max", "a_max", "alpha_max", "wheel_max"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300, 1e-300, -1.0, 0.0])
def test_a_base_that_no_single_precision_holds_is_refused(name, value):
    base = {"joints": ("x", "y", "yaw"), "radius": 0.1, "track": 0.4, "v_max": 1.0, "omega_max": 1.0}
    with pytest.raises(SettingError, match=name):
        gp.DiffDrive(**({**base, "a_max": 1.0, "alpha_max": 1.0} | {name: value}))

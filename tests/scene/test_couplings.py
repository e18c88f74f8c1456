"""Equalities of a model: refused where planned joints break them, fulfilled by everything that is not planned."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnsupportedError

_ARM = """<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="target" mocap="true" pos="1 1 1"><geom type="sphere" size=".01" contype="0" conaffinity="0"/></body>
    <body name="crate" pos="2 0 0"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
    <body name="bolted" pos="-2 0 0"><geom type="box" size=".1 .1 .1"/></body>
    <body name="r/base"><geom type="box" size=".05 .05 .05"/>
      <body name="r/rod" pos="-.3 0 0"><joint name="r/rod" axis="0 0 1" range="-2 2"/>
        <geom type="box" size=".02 .02 .1"/></body>
      <body name="r/one" pos="0 0 .2"><joint name="r/j1" axis="0 0 1" range="-2 2"/>
        <geom type="capsule" fromto=".05 0 0 .3 0 0" size=".03"/>
        <body name="r/two" pos=".4 0 0"><joint name="r/j2" axis="0 0 1" range="-2 2"/>
          <geom type="capsule" fromto=".05 0 0 .3 0 0" size=".03"/>
          <body name="r/hand" pos=".4 0 0"><geom type="box" size=".03 .03 .03"/>
            <body name="r/tcp" pos=".1 0 0"/>
            <body name="r/left" pos=".05 .02 0">
              <joint name="r/left" type="slide" axis="0 1 0" range="0 .04"/>
              <geom type="box" size=".02 .01 .01"/></body>
            <body name="r/right" pos=".05 -.02 0">
              <joint name="r/right" type="slide" axis="0 -1 0" range="0 .04"/>
              <geom type="box" size=".02 .01 .01"/></body>
          </body></body></body></body>
  </worldbody>
  <tendon><fixed name="split"><joint joint="r/j1" coef="1"/><joint joint="r/j2" coef="1"/></fixed></tendon>
  <equality>{equality}</equality>
</mujoco>"""
_LIMITS = {"velocity": [1.0, 1.0], "acceleration": [5.0, 5.0]}

# A parallel gripper: crank and rocker carry a finger; the finger is welded to the rocker, so the chain closes by pins.
_LINKAGE = """<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="r/base"><geom type="box" size=".05 .05 .05"/>
      <body name="r/arm" pos="0 0 .2"><joint name="r/arm" axis="0 0 1" range="-2 2"/>
        <geom type="capsule" fromto=".05 0 0 .3 0 0" size=".03"/><site name="r/tool" pos=".5 0 0"/>
        <body name="r/crank" pos=".3 .02 0"><joint name="r/crank" axis="0 0 1" range="-1 1"/>
          <geom type="capsule" fromto="0 0 0 .1 0 0" size=".005"/>
          <body name="r/finger" pos=".1 0 0"><joint name="r/finger" axis="0 0 1" range="-2 2"/>
            <geom type="box" size=".02 .03 .01" pos=".02 .03 0"/></body></body>
        <body name="r/rocker" pos=".3 .08 0"><joint name="r/rocker" axis="0 0 1" range="-2 2"/>
          <geom type="capsule" fromto="0 0 0 .1 0 0" size=".005"/></body>
      </body></body>
  </worldbody>
  <equality><connect name="pin" body1="r/rocker" body2="r/finger" anchor=".1 0 0"/></equality>
  <actuator><position joint="r/crank" kp="10"/></actuator>
</mujoco>"""


def _arm(equality: str = "", **changes: object) -> gp.Scene:
    given = {"robot": "r/", "tool": "r/tcp"} | _LIMITS | changes
    return gp.Scene.from_mjcf(_ARM.format(equality=equality), **given)  # type: ignore[arg-type]


def _at(scene: gp.Scene, *joints: str) -> list[float]:
    return [float(scene.home_qpos[scene.model.joint(f"r/{joint}").qposadr[0]]) for joint in joints]


@pytest.mark.parametrize(
    ("equality", "words"),
    [
        ('<joint name="tie" joint1="r/j2" joint2="r/j1" polycoef="0 -1 0 0 0"/>', "'tie' of r/j2 and r/j1.*r/j1, r/j2"),
        ('<joint joint1="r/j2" polycoef=".3 0 0 0 0"/>', "joint equality of r/j2"),
        ('<joint joint1="r/rod" joint2="r/j1"/>', "joint equality of r/rod and r/j1"),
        ('<connect name="rod" body1="r/rod" body2="r/one" anchor="0 0 0"/>', "connect equality 'rod'"),
        ('<weld body1="r/hand" body2="bolted"/>', "weld equality of r/hand and bolted"),
        ('<connect body1="r/hand" body2="world" anchor="0 0 0"/>', "connect equality of r/hand and world"),
        ('<tendon tendon1="split"/>', "tendon equality of split"),
    ],
)
def test_equalities_of_planned_joints_are_refused_by_name(equality: str, words: str) -> None:
    with pytest.raises(UnsupportedError, match=words):
        _arm(equality)


@pytest.mark.parametrize("active", ['active="false"', ""])
def test_equalities_that_are_switched_off_do_not_matter(active: str) -> None:
    text = _ARM.format(equality=f'<joint joint1="r/j2" joint2="r/j1" {active}/>')
    if not active:
        text = text.replace("<compiler", '<option><flag equality="disable"/></option><compiler')
    assert len(gp.Scene.from_mjcf(text, robot="r/", tool="r/tcp", **_LIMITS).joints) == 2  # type: ignore[arg-type]


def test_a_coupled_joint_can_be_left_out_of_the_plan() -> None:
    equality = '<joint joint1="r/j2" joint2="r/j1" polycoef=".1 -1 0 0 0"/>'
    given = {"velocity": [1.0], "acceleration": [5.0]}
    with pytest.raises(UnsupportedError, match="r/j2 and r/j1"):
        _arm(equality, joints=["r/j2"], **given)
    rod = _arm('<joint joint1="r/rod" joint2="r/j1" polycoef=".1 -1 0 0 0"/>', joints=["r/j2"], **given)
    assert _at(rod, "rod", "j1") == [pytest.approx(0.1), 0.0]
    turned = rod.with_state({"r/j1": 0.5})
    assert _at(turned, "rod", "j1") == [pytest.approx(-0.4), 0.5]


@pytest.mark.parametrize(("other", "stays"), [("crate", "crate"), ("target", "target")])
def test_ties_to_loose_bodies_are_named_and_ignored(other: str, stays: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        _arm(f'<weld body1="r/hand" body2="{other}"/>')
    assert f"weld equality of r/hand and {stays}" in caplog.text
    named = _ARM.replace('"target"', '"r/mocap"').format(equality='<weld body1="r/mocap" body2="r/hand"/>')
    assert len(gp.Scene.from_mjcf(named, robot="r/", tool="r/tcp", **_LIMITS).joints) == 2  # type: ignore[arg-type]
    caplog.clear()
    _arm('<weld body1="r/hand" body2="crate"/>', carried="crate", X_TO=np.eye(4))
    assert "weld" not in caplog.text


def test_limits_of_tendons_on_planned_joints_are_named(caplog: pytest.LogCaptureFixture) -> None:
    text = _ARM.format(equality="").replace('name="split"', 'name="split" range="-1 1"')
    gp.Scene.from_mjcf(text, robot="r/", tool="r/tcp", **_LIMITS)  # type: ignore[arg-type]
    assert "limits of tendon 'split'" in caplog.text and "r/j1, r/j2" in caplog.text


_FINGERS = '<joint joint1="r/right" joint2="r/left" polycoef=".001 .5 0 0 0"/>'


@pytest.mark.parametrize("tool", ["r/tcp", "r/hand"])
@pytest.mark.parametrize(
    ("fingers", "expected"),
    [
        (None, [0.0, 0.001]),
        (0.02, [0.02, 0.011]),
        ({"r/left": 0.02}, [0.02, 0.011]),
        ({"r/right": 0.011}, [0.02, 0.011]),
        ({"r/left": 0.02, "r/right": 0.011}, [0.02, 0.011]),
    ],
)
def test_followers_follow_however_the_leader_is_set(tool: str, fingers: object, expected: list[float]) -> None:
    def check(scene: gp.Scene) -> None:
        assert _at(scene, "left", "right") == pytest.approx(expected, abs=1e-12)

    scene = _arm(_FINGERS, tool=tool, fingers=fingers)
    check(scene)
    check(_arm(_FINGERS, tool=tool).attach("crate", X_TO=np.eye(4), fingers=fingers))  # type: ignore[arg-type]
    check(_arm(_FINGERS, tool=tool, fingers=0.04).attach("crate", X_TO=np.eye(4), fingers=fingers or 0.0))  # type: ignore[arg-type]
    if isinstance(fingers, dict):
        check(_arm(_FINGERS, tool=tool, fingers=0.04).with_state(fingers))


def test_a_tool_that_is_a_leaf_changes_nothing_about_the_gripper() -> None:
    by_leaf, by_hand = _arm(tool="r/tcp", fingers=0.03), _arm(tool="r/hand", fingers=0.03)
    assert _at(by_leaf, "left", "right") == _at(by_hand, "left", "right") == [0.03, 0.03]
    assert by_leaf.gripper_bodies == by_hand.gripper_bodies
    held = by_leaf.attach("crate", X_TO=np.eye(4)), by_hand.attach("crate", X_TO=np.eye(4))
    assert held[0].allowed_contacts == held[1].allowed_contacts
    assert {"r/hand", "r/left", "r/right"} <= {c.first for c in held[0].allowed_contacts}


@pytest.mark.parametrize(
    ("fingers", "words"),
    [
        ({"r/left": 0.02, "r/right": 0.03}, "position of r/right = 0.03, expected 0.011"),
        (0.05, "position of r/left"),
    ],
)
def test_impossible_fingers(fingers: object, words: str) -> None:
    with pytest.raises(SettingError, match=words):
        _arm(_FINGERS, fingers=fingers)


def test_a_follower_cannot_be_set_without_its_leader_if_many_positions_fit() -> None:
    square = '<joint joint1="r/right" joint2="r/left" polycoef="0 0 10 0 0"/>'
    assert _at(_arm(square, fingers={"r/left": 0.03}), "right") == [pytest.approx(0.009)]
    with pytest.raises(SettingError, match="the position of r/left, which it follows"):
        _arm(square, fingers={"r/right": 0.01})


def _gap(scene: gp.Scene) -> float:
    """Return the largest residual of the model's equalities, by MuJoCo."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.home_qpos
    mujoco.mj_fwdPosition(scene.model, data)
    mine = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    return float(np.abs(data.efc_pos[mine]).max())


def _linkage(**changes: object) -> gp.Scene:
    given = {"robot": "r/", "tool": "r/tool", "velocity": [1.0], "acceleration": [5.0]} | changes
    return gp.Scene.from_mjcf(_LINKAGE, **given)  # type: ignore[arg-type]


def test_passive_joints_close_their_chain() -> None:
    at_rest = _linkage()
    assert _at(at_rest, "crank", "finger", "rocker") == [0.0, 0.0, 0.0]
    for crank in (-0.7, 0.4, 0.9):
        scene = _linkage(fingers=crank)
        assert _gap(scene) < 1e-5
        # A parallelogram: the rocker turns as the crank, the finger keeps its direction.
        assert _at(scene, "crank", "finger", "rocker") == pytest.approx([crank, -crank, crank], abs=1e-4)
    assert _gap(at_rest.with_state({"r/crank": 0.6})) < 1e-5
    with pytest.raises(SettingError, match="close connect equality 'pin'"):
        _linkage(fingers={"r/crank": 0.5, "r/rocker": -0.5})


def test_a_chain_without_a_drive_wants_positions_by_name() -> None:
    text = _LINKAGE.replace('<actuator><position joint="r/crank" kp="10"/></actuator>', "")
    given = {"robot": "r/", "tool": "r/tool", "velocity": [1.0], "acceleration": [5.0]}
    with pytest.raises(SettingError, match="positions by joint name, as none leads: r/crank, r/finger, r/rocker"):
        gp.Scene.from_mjcf(text, fingers=0.3, **given)  # type: ignore[arg-type]
    assert _gap(gp.Scene.from_mjcf(text, fingers={"r/crank": 0.3}, **given)) < 1e-5  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("behind", "tool", "holding"),
    [
        # A jaw directly on the last link, which is the other jaw; the tool is a leaf without geometry.
        ('<body name="r/jaw"><joint name="r/jaw"/>{box}</body><body name="r/tcp"/>', "r/tcp", {"last", "jaw"}),
        # A hand that is fixed to the last link.
        ('<body name="r/hand">{box}<body name="r/jaw"><joint name="r/jaw"/>{box}</body></body>'
         '<body name="r/tcp"/>', "r/tcp", {"hand", "jaw"}),
        # A suction cup, and a flange alone.
        ('<body name="r/cup">{box}</body><body name="r/tcp"/>', "r/tcp", {"cup"}),
        ('<body name="r/tcp"/>', "r/tcp", {"last"}),
        ('<body name="r/hand">{box}</body>', "r/last", {"last", "hand"}),
    ],
)  # fmt: skip
def test_what_hangs_on_the_last_planned_joint_holds(behind: str, tool: str, holding: set[str]) -> None:
    box = '<geom type="box" size=".02 .02 .02"/>'
    text = f"""<mujoco><worldbody><body name="crate"><freejoint/>{box}</body>
      <body name="r/base" pos="1 0 0">{box}<body name="r/last" pos="0 0 .2"><joint name="r/j" range="-1 1"/>{box}
      {behind.format(box=box)}</body></body></worldbody></mujoco>"""
    given = {"velocity": [1.0], "acceleration": [5.0], "carried": "crate", "X_TO": np.eye(4)}
    scene = gp.Scene.from_mjcf(text, robot="r/", tool=tool, **given)  # type: ignore[arg-type]
    assert {contact.first.removeprefix("r/") for contact in scene.allowed_contacts} == holding

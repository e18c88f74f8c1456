"""Grippers of all kinds hold in the simulation and fail in it: linkages, jaws, URDF without drives, vacuum cups."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from grippers import CUP, GOAL, JAW, JAW_DRIVE, SLIDES, START, armed, below, linkage

import failbench as fb
import graceful_plan as gp
from failbench import ObjectLost, SimSettings, build_world, execute
from graceful_plan.exceptions import UnsupportedError

_SLIP = 5e-3
"""Slip of a healthy grasp [m]; objects are lost at 2 cm."""
_MOTION = [START, GOAL]

URDF = """<robot name="u"><link name="base"><collision><geometry><box size=".1 .1 .1"/></geometry></collision></link>
<link name="boom"><inertial><mass value="2"/><inertia ixx=".02" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz=".2 0 .1"/><geometry><box size=".3 .05 .05"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 0 1"/><origin xyz="0 0 .6"/>
  <limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
<link name="tcp"/><joint name="tcp" type="fixed"><parent link="boom"/><child link="tcp"/>
  <origin xyz=".45 0 .04" rpy="3.14159265 0 0"/></joint>
{finger_one}{finger_two}</robot>"""
_FINGER = """<link name="{name}">
  <inertial><mass value=".05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 {y} -.06"/><geometry><box size=".02 .01 .06"/></geometry></collision></link>
<joint name="{name}" type="revolute"><parent link="boom"/><child link="{name}"/><axis xyz="{axis} 0 0"/>
  <origin xyz=".45 0 .1"/><limit lower="-.1" upper=".6" effort="1000" velocity="1"/>{mimic}</joint>"""


def scissors() -> gp.Scene:
    """Return a robot from URDF whose second finger mimics the first; it has no drives."""
    one = _FINGER.format(name="one", y=".02", axis="1", mimic="")
    two = _FINGER.format(name="two", y="-.02", axis="-1", mimic='<mimic joint="one"/>')
    block = """<mujoco><worldbody><body name="block" pos="1 0 .1"><freejoint/>
      <geom type="box" size=".02 .02 .03" mass=".2" friction="1 .005 .0001" condim="4"/></body></worldbody></mujoco>"""
    text = URDF.format(finger_one=one, finger_two=two)
    scene = gp.Scene.from_urdf(text, tool="tcp", acceleration=5.0, world=block)
    return scene.attach("block", X_TO=below(0.02), fingers=gp.Opening())


@pytest.mark.parametrize("fingers", [None, gp.Opening()])
def test_a_linkage_holds_by_friction_and_drops_when_it_fails(fingers: gp.Opening | None) -> None:
    scene = linkage(carried="block", X_TO=below(0.02), fingers=fingers)
    world = build_world(scene)
    assert world.robot.grip_open == pytest.approx([0.0]) and world.robot.grip_closed == pytest.approx([0.8])
    assert execute(_MOTION, world).slip < _SLIP
    report = fb.validate(_MOTION, scene, "*/gripper_failure/critical", n=2)
    assert report.dropped.mean == 1.0


def test_a_jaw_holds_against_a_fixed_one() -> None:
    X_TO = below(0.0)
    X_TO[1, 3] = -0.005
    scene = armed(JAW, drive=JAW_DRIVE, carried="block", X_TO=X_TO, fingers=gp.Opening())
    world = build_world(scene)
    assert {world.model.geom(g).name for g in world.robot.pads} >= {"g/fixed", "g/moving"}
    assert execute(_MOTION, world).slip < _SLIP


def test_fingers_without_drives_press_like_the_bundled_hand() -> None:
    scene = armed(SLIDES, carried="block", X_TO=below(0.02), fingers=gp.Opening())
    world = build_world(scene)
    limits = world.model.actuator_forcerange[world.robot.gripper_actuators, 1]
    assert limits == pytest.approx([70.0], rel=1e-3)  # one motor moves both
    assert gp.GraspHolds().grip(scene).force == pytest.approx(70.0)
    assert execute(_MOTION, world).slip < _SLIP


def test_a_robot_from_urdf_has_servos_and_its_fingers_follow_under_load() -> None:
    scene = scissors()
    world = build_world(scene)
    assert world.model.actuator_forcerange[world.robot.actuators] == pytest.approx(np.array([[-50.0, 50.0]]))
    done = execute(_MOTION, world)
    assert done.slip < _SLIP and done.tracking_error.max() < 0.01
    q = done.states[:, 1 + world.model.jnt_qposadr[world.robot.gripper_joints]]
    assert np.abs(q[:, 0] - q[:, 1]).max() < 0.02  # 70 N would bend a soft coupling by a third of a radian


def test_links_that_overlap_do_not_push_each_other_apart() -> None:
    contacts = [gp.AllowedContact("g/palm", "a/turn"), gp.AllowedContact("g/left_pad", "g/right_pad")]
    scene = linkage(allowed_contacts=contacts)
    model = build_world(scene).model
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    fingers = tuple(sorted(model.body(f"g/{side}_finger").id for side in ("left", "right")))
    assert fingers in {tuple(sorted(pair)) for pair in excluded}


def test_ties_to_mocap_bodies_do_not_hold_the_arm() -> None:
    spec = armed(CUP).spec.copy()
    spec.worldbody.add_body(name="handle", mocap=True, pos=[2.0, 0.0, 0.0])
    weld = spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    weld.name1, weld.name2 = "handle", "g/palm"
    scene = gp.Scene.from_mjcf(spec, robot="a/", tool="g/tool", velocity=[2.0], acceleration=[6.0])
    assert execute(_MOTION, build_world(scene)).tracking_error.max() < 0.02


def test_a_cup_holds_by_its_force_and_drops_without_it() -> None:
    scene = armed(CUP).attach("block", X_TO=below(0.06), grip=gp.Adhesion(30.0, 0.02))
    world = build_world(scene)
    assert world.robot.grip_open == [0.0] and world.robot.grip_closed == [1.0]
    assert execute(_MOTION, world).slip < _SLIP
    report = fb.validate(_MOTION, scene, ["*/gripper_failure/critical", "*/weak_grip/critical"], n=4)
    assert report.dropped.mean == 1.0
    weaker = fb.validate(_MOTION, scene, "*/weak_grip/minor", n=2)
    assert weaker.dropped.mean == 0.0  # 9 N are three times the weight


def test_a_grasp_that_touches_nothing_says_so() -> None:
    with pytest.raises(ObjectLost, match=r"no finger touches it \(\d+ mm away\)"):
        execute(_MOTION, build_world(linkage(carried="block", X_TO=below(0.3))))
    apart = armed(CUP).attach("block", X_TO=below(0.08), grip=gp.Adhesion(30.0, 0.02))
    with pytest.raises(ObjectLost, match=r"the gripper does not touch it \(\d+ mm away\)"):
        execute(_MOTION, build_world(apart))
    with pytest.raises(ObjectLost, match=r"only g/jaw touches it|no finger touches it"):
        aside = below(0.0)
        aside[1, 3] = 0.08
        execute(_MOTION, build_world(armed(JAW, drive=JAW_DRIVE, carried="block", X_TO=aside)))


def test_a_gripper_without_joints_needs_adhesion_or_a_weld() -> None:
    scene = armed(CUP, carried="block", X_TO=below(0.06))
    with pytest.raises(UnsupportedError, match=r"Adhesion.*SimSettings"):
        build_world(scene)
    assert build_world(scene, SimSettings(grasp="weld")).robot.weld >= 0

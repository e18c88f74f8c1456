"""Choice of the joints to plan: one of two arms, both at once, an arm on a torso that stays where it is."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.analysis.certified_clearance import certified_clearance
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.judge.exact import exactly_free
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.judge.motion_samples import motion_samples
from graceful_plan.judge.torque_check import joint_torques
from graceful_plan.timing.dynamics import RobotDynamics


def _arm(side: str, y: float) -> str:
    link = '<geom type="capsule" fromto=".06 0 0 .3 0 0" size=".04" mass="1"/>'
    return f"""<body name="r/{side}1" pos="0 {y} .1"><joint name="r/{side}1" axis="0 0 1" range="-2.5 2.5"/>{link}
      <body name="r/{side}2" pos=".36 0 0"><joint name="r/{side}2" axis="0 0 1" range="-2.5 2.5"/>{link}
      <body name="r/{side}3" pos=".36 0 0"><joint name="r/{side}3" axis="0 1 0" range="-1 1"/>{link}
      <site name="r/{side}_tool" pos=".4 0 0"/></body></body></body>"""


_TWO = f"""<mujoco><compiler angle="radian"/><worldbody>
  <body name="post" pos="1.2 0 .5"><geom name="post" type="cylinder" size=".05 .5"/></body>
  <body name="cup" pos=".9 .5 .6"><freejoint/><geom type="box" size=".03 .03 .03" mass=".2"/></body>
  <body name="r/base" pos="0 0 .3"><geom name="r/base" type="box" size=".08 .08 .1"/>
    <body name="r/torso" pos="0 0 .13"><joint name="r/torso" type="slide" axis="0 0 1" range="0 .3"/>
      <geom name="r/torso" type="box" size=".05 .35 .02"/>
      {_arm("l", 0.4)}{_arm("r", -0.4)}
    </body></body>
</worldbody>
<keyframe><key name="apart" qpos=".9 .5 .6 1 0 0 0  .1  .5 .1 0  -.5 -.1 0"/></keyframe></mujoco>"""
LEFT, RIGHT = [f"r/l{k}" for k in (1, 2, 3)], [f"r/r{k}" for k in (1, 2, 3)]


def _scene(joints: list[str] | None, tool: str = "r/l_tool", **changes: object) -> gp.Scene:
    n = 4 if joints is None else len(joints)
    given = {"robot": "r/", "tool": tool, "velocity": [1.0] * n, "acceleration": [5.0] * n} | changes
    return gp.Scene.from_mjcf(_TWO, joints=joints, **given)  # type: ignore[arg-type]


def test_by_default_the_joints_to_the_tool_are_planned() -> None:
    assert _scene(None).joints == ("r/torso", *LEFT)
    assert _scene(None, tool="r/r_tool").joints == ("r/torso", *RIGHT)


@pytest.mark.parametrize("height", [0.0, 0.2])
def test_a_torso_stays_where_it_is_put(height: float) -> None:
    scene = _scene(LEFT, state={"r/torso": height})
    assert scene.joints == tuple(LEFT)
    q = np.array([0.3, -0.2, 0.4])
    whole = _scene(None).data_at([height, *q])
    np.testing.assert_allclose(scene.data_at(q).site("r/l_tool").xpos, whole.site("r/l_tool").xpos, atol=1e-12)
    np.testing.assert_allclose(gp.StateBatch(scene, q[None]).tool_poses[0, :3, 3], whole.site("r/l_tool").xpos)
    result = gp.plan([0.0, 0.0, 0.0], [1.0, 0.5, 0.3], scene, w=0.0, iterations=200)
    assert result.status is gp.PlanStatus.SOLVED, result.detail


def test_the_other_arm_is_an_obstacle_in_any_posture() -> None:
    across = np.array([-0.7, -0.5, 0.0])
    for posture, free in (({"r/r1": -1.5}, True), ({"r/r1": 0.7, "r/r2": 0.5}, False)):
        scene = _scene(LEFT).with_state(posture)
        assert exactly_free(across[None], scene).item() is free
        assert (float(gp.clearance(across, scene)) > 0.0) is free
        status = gp.plan([1.5, 0.0, 0.0], across, scene, w=0.0, iterations=200).status
        assert status is (gp.PlanStatus.SOLVED if free else gp.PlanStatus.INVALID_GOAL)
    assert _scene(LEFT, state="apart").with_state(keyframe="apart").state_differences("apart") == ()


def test_two_arms_are_planned_at_once() -> None:
    scene = _scene([*LEFT, *RIGHT])
    kernels = compile_scene(scene).kernels
    q = np.random.default_rng(0).uniform(*scene.limits.position.T, (400, 6))
    exact, cautious = exactly_free(q, scene), kernels.clearance(q) > 0.0
    assert 0.2 < exact.mean() < 0.9
    assert not (cautious & ~exact).any()  # spheres are never optimistic
    assert (cautious & exact).sum() > 0.8 * exact.sum()
    start, goal = [0.6, 0.3, 0.0, 0.2, 0.9, 0.0], [-0.2, -0.9, 0.0, -0.6, -0.3, 0.0]
    assert exactly_free(np.array([start, goal]), scene).all()
    result = gp.plan(start, goal, scene, w=0.0, iterations=3000)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert gp.verify(result.unwrap(), scene, goal=goal)
    np.testing.assert_allclose(scene.keyframes["apart"], [0.5, 0.1, 0.0, -0.5, -0.1, 0.0])


def test_what_one_hand_holds_keeps_away_from_the_other_arm() -> None:
    scene = _scene([*LEFT, *RIGHT]).attach("cup", X_TO=np.eye(4))
    assert {c.first for c in scene.allowed_contacts} == {"r/l3"}
    for tool in ("r/l_tool", "r/r_tool"):
        hand = _scene([*LEFT, *RIGHT], tool=tool)
        assert {hand.model.body(body).name for body in hand.gripper_bodies} == {tool.replace("_tool", "3")}


@pytest.mark.parametrize(
    ("joints", "error", "words"),
    [
        (["r/l1", "r/elbow"], UnknownNameError, "joint to plan 'r/elbow'; valid: r/l1"),
        (["r/l2", "r/l1", "r/l3"], SettingError, "order of the model.*'r/l1', 'r/l2', 'r/l3'"),
        (["r/l1", "r/l1"], SettingError, "each joint once"),
        (RIGHT, SettingError, "one that moves the tool"),
        ([], SettingError, "one that moves the tool"),
    ],
)
def test_impossible_joints(joints: list[str], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        _scene(joints)


def test_the_judge_places_both_arms_as_mujoco_does() -> None:
    for joints in ([*LEFT, *RIGHT], ["r/torso", *LEFT, *RIGHT], RIGHT):
        scene = _scene(joints, tool="r/r_tool", carried="cup", X_TO=np.eye(4))
        q = np.random.default_rng(1).uniform(*scene.limits.position.T, (4, len(joints)))
        known = kinematics(scene)
        poses = known.poses(q, known.geoms)
        axes = known.joint_axes(np.stack(list(known.links(q))))
        for k, configuration in enumerate(q):
            data = scene.data_at(configuration)
            np.testing.assert_allclose(poses[:, k, :3, 3], data.geom_xpos, atol=1e-12)
            for j, name in enumerate(scene.joints):
                np.testing.assert_allclose(axes[j, k, :3, 1], data.joint(name).xaxis, atol=1e-12)


def test_no_point_of_either_arm_moves_farther_than_a_step() -> None:
    scene, step = _scene([*LEFT, *RIGHT]), 0.01
    path = gp.Path(np.array([[0.6, 0.3, 0.0, 0.2, 0.9, 0.0], [-0.2, -0.9, 0.5, -0.6, -0.3, 0.5]]))
    samples = motion_samples(path, scene, step)
    tips = np.array([[scene.data_at(q).site(f"r/{side}_tool").xpos for side in "lr"] for q in samples.q])
    assert np.linalg.norm(np.diff(tips, axis=0), axis=2).max() <= step
    # Two arms that move towards each other: the certificate must not believe in the motion of one alone.
    bound = certified_clearance(path, compile_scene(scene).proof)
    exact = compile_scene(scene).kernels.clearance(np.linspace(*path.q, 2000)).min()
    assert bound.bound <= exact + 1e-6


_TWO_PREFIXES = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="robot0_base"><geom size=".05"/>
    <body name="robot0_hand" pos="0 0 .5"><joint name="turn" axis="0 1 0" range="-2 2"/>
      <geom type="capsule" fromto="0 0 0 0 0 .4" size=".04"/>
      <body name="gripper0_palm" pos="0 0 .5"><site name="gripper0_grip" pos="0 0 .15"/><geom size=".03"/>
        <body name="gripper0_left" pos="0 .02 .1"><joint name="left" type="slide" axis="0 1 0" range="0 .04"/>
          <geom size=".01"/></body>
        <body name="gripper0_right" pos="0 -.02 .1"><joint name="right" type="slide" axis="0 1 0" range="-.04 0"/>
          <geom size=".01"/></body></body></body></body>
  <body name="cup" pos="1 0 .5"><freejoint/><geom size=".03"/></body></worldbody></mujoco>"""
"""A gripper whose bodies have another prefix than the arm's, with fingers that mirror each other."""


def _two_prefixes(robot: str = "robot0_", fingers: float | dict[str, float] | None = None) -> gp.Scene:
    return gp.Scene.from_mjcf(
        _TWO_PREFIXES, robot=robot, tool="gripper0_grip", velocity=[1.0], acceleration=[5.0], fingers=fingers
    )


@pytest.mark.parametrize("robot", ["robot0_", "robot0_base"])
def test_a_gripper_with_another_prefix_is_part_of_the_robot(robot: str) -> None:
    scene = _two_prefixes(robot)
    assert {scene.model.body(b).name for b in scene.robot_bodies} == {
        "robot0_base",
        "robot0_hand",
        "gripper0_palm",
        "gripper0_left",
        "gripper0_right",
    }
    assert scene.joints == ("turn",)


def test_mirrored_fingers_are_told_by_name() -> None:
    with pytest.raises(SettingError, match=r"fingers=\{'left': 0\.03, 'right': -0\.03\}"):
        _two_prefixes(fingers=0.03)
    with pytest.raises(SettingError, match=r"position of left = 0\.05"):
        _two_prefixes(fingers=0.05)
    scene = _two_prefixes(fingers={"left": 0.03, "right": -0.03})
    assert scene.home_qpos[1:3].tolist() == [0.03, -0.03]
    assert _two_prefixes(fingers=0.0).home_qpos[1:3].tolist() == [0.0, 0.0]


def test_the_judge_computes_the_torques_of_both_arms_as_mujoco_does() -> None:
    scene = _scene(["r/torso", *LEFT, *RIGHT], torque=[100.0] * 7)
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 20, 7))
    inverse = RobotDynamics(scene)
    expected = [inverse(*state) for state in zip(q, qd, qdd, strict=True)]
    np.testing.assert_allclose(joint_torques(q, qd, qdd, scene), expected, atol=1e-9)

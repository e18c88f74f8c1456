"""The judge's kinematics: all poses equal MuJoCo's, in every scene and for robots from other sources."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.judge.motion_samples import _levers_near, reach  # pyright: ignore[reportPrivateUsage]
from graceful_plan.scene.loading.bundled import mobile_scenes, scenes
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

_TOLERANCE = 1e-9
"""Error of poses [m or of a unit axis]: some hundred roundings, a few metres from the origin."""
SCENES = (*scenes(), *mobile_scenes())
_POINT = np.array([0.1, -0.2, 0.3])
"""A point of the carried object [m]."""

_ODD = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="ground" type="plane" size="3 3 .1"/>
    <body name="clock" mocap="true" pos="1 1 1" quat=".8 .6 0 0"><geom type="box" size=".1 .1 .1"/></body>
    <body name="r/column" pos="0 0 .5" euler="0 0 .4">
      <joint name="r/slide" type="slide" axis=".6 0 .8" pos=".1 .2 .3" range="-1 1" ref=".3"/>
      <joint name="r/turn" axis="0 0 1" pos=".05 -.02 0" range="-3 3" ref="-.5"/>
      <geom type="capsule" fromto="0 0 0 .2 0 0" size=".03"/>
      <body name="r/flag" pos="0 .1 .2"><joint name="r/flag" type="ball"/><geom type="box" size=".1 .01 .05"/></body>
      <body name="r/plate" pos=".2 0 0" euler=".2 .3 .4">
        <geom type="ellipsoid" size=".03 .04 .05"/>
        <body name="r/fore" pos="0 0 .1" quat=".5 .5 .5 .5">
          <joint name="r/lift" axis="0 -1 0" range="-2 2"/>
          <geom type="capsule" fromto="0 0 0 .2 .1 0" size=".02"/>
          <body name="r/hand" pos=".3 0 0" euler="0 1 0">
            <joint name="r/reach" type="slide" axis="0 0 1" range="0 .3"/>
            <joint name="r/roll" axis="1 1 0" pos="0 0 .1" range="-3 3"/>
            <geom type="box" size=".03 .02 .05"/>
            <site name="r/tool" pos=".02 .03 .12" euler=".3 0 -.2"/>
            <body name="r/left" pos="0 .03 .05"><joint name="r/left" type="slide" axis="0 1 0" range="0 .04"/>
              <geom type="box" size=".01 .01 .03"/></body>
            <body name="r/right" pos="0 -.03 .05"><joint name="r/right" type="slide" axis="0 -1 0" range="0 .04"/>
              <geom type="box" size=".01 .01 .03"/></body>
          </body>
        </body>
      </body>
    </body>
    <body name="box" pos="1.5 0 1"><freejoint/><geom type="box" size=".04 .03 .02" mass=".2"/>
      <body name="lid" pos="0 0 .05" euler=".2 0 0"><geom type="box" size=".04 .03 .004"/></body></body>
    <body name="door" pos="0 2 1"><joint name="door" axis="0 0 1" range="0 2" ref=".4"/>
      <geom type="box" size=".4 .02 .9"/></body>
  </worldbody>
  <equality><joint joint1="r/left" joint2="r/right" polycoef="-.01 1 0 0 0"/></equality>
</mujoco>
"""
_MIMIC = """
<robot name="lift">
  <link name="base"/>
  <link name="car"><collision><geometry><box size=".1 .1 .1"/></geometry></collision></link>
  <link name="arm"><collision><origin xyz=".1 0 0"/><geometry><box size=".2 .04 .04"/></geometry></collision></link>
  <link name="tip"/>
  <link name="f1"><collision><geometry><box size=".02 .02 .06"/></geometry></collision></link>
  <link name="f2"><collision><geometry><box size=".02 .02 .06"/></geometry></collision></link>
  <joint name="up" type="prismatic"><parent link="base"/><child link="car"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" velocity="1" effort="10"/></joint>
  <joint name="turn" type="continuous"><parent link="car"/><child link="arm"/><origin xyz=".1 0 0" rpy=".1 .2 .3"/>
    <axis xyz="0 .6 .8"/><limit velocity="1" effort="10"/></joint>
  <joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz=".25 0 0" rpy="0 1.57 0"/></joint>
  <joint name="g1" type="prismatic"><parent link="tip"/><child link="f1"/><origin xyz="0 .02 0"/><axis xyz="0 1 0"/>
    <limit lower="0" upper=".04" velocity="1" effort="10"/></joint>
  <joint name="g2" type="prismatic"><parent link="tip"/><child link="f2"/><origin xyz="0 -.02 0"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper=".04" velocity="1" effort="10"/><mimic joint="g1" multiplier=".5" offset=".01"/></joint>
</robot>
"""


def _odd(carried: str | None = None) -> Scene:
    given = {"velocity": [1.0] * 5, "acceleration": [1.0] * 5, "fingers": {"r/left": 0.01, "r/right": 0.02}}
    X_TO = [[0.0, 1.0, 0.0, 0.02], [-1.0, 0.0, 0.0, 0.01], [0.0, 0.0, 1.0, 0.05], [0.0, 0.0, 0.0, 1.0]]
    return Scene.from_mjcf(_ODD, robot="r/", tool="r/tool", carried=carried, X_TO=X_TO if carried else None, **given)


def _random(scene: Scene, n: int) -> np.ndarray:
    low, high = scene.limits.position.T
    return np.random.default_rng(3).uniform(np.maximum(low, -7.0), np.minimum(high, 7.0), (n, len(low)))


def _pose(p: np.ndarray, R: np.ndarray) -> np.ndarray:
    return np.block([[R.reshape(3, 3), p[:, None]], [np.zeros(3), 1.0]])


def _check(scene: Scene, n: int = 5) -> None:
    """Compare every geom, the tool, the carried object and the axes of planned joints with MuJoCo."""
    q, known, placement = _random(scene, n), kinematics(scene), Placement(scene)
    geoms, held = (known.poses(q, frames) for frames in (known.geoms, known.held))
    axes = known.joint_axes(np.stack(list(known.links(q))))
    joints = [scene.model.joint(name).id for name in scene.joints]
    tool = scene.model.site(scene.tool).id
    for k in range(n):
        data = placement.place(q[k])
        wanted = [_pose(p, R) for p, R in zip(data.geom_xpos, data.geom_xmat, strict=True)]
        np.testing.assert_allclose(geoms[:, k], wanted, atol=_TOLERANCE)
        wanted = [_pose(data.site_xpos[tool], data.site_xmat[tool])]
        if scene.carried is not None:
            body = scene.model.body(scene.carried.body).id
            wanted.append(_pose(data.xpos[body], data.xmat[body]))
            point = wanted[1] @ np.append(_POINT, 1.0)
            np.testing.assert_allclose(known.held_point(q, _POINT)[k], point[:3], atol=_TOLERANCE)
        np.testing.assert_allclose(held[:, k], wanted, atol=_TOLERANCE)
        point, axis = axes[:, k, :3, 0], axes[:, k, :3, 1]
        np.testing.assert_allclose(axis, data.xaxis[joints], atol=_TOLERANCE)
        # Any point of the axis is valid.
        np.testing.assert_allclose(np.cross(point - data.xanchor[joints], axis), 0.0, atol=_TOLERANCE)


@pytest.mark.parametrize("name", SCENES)
def test_poses_equal_those_of_mujoco_with_and_without_objects(name: str) -> None:
    scene = gp.load_scene(name)
    held = {task.object_name: task.scene for task in scene.tasks.values() if task.object_name is not None}
    for one in [scene, *held.values()]:
        _check(one)


@pytest.mark.parametrize("carried", [None, "box"])
def test_slides_several_joints_of_a_body_and_joints_that_are_held_are_placed_as_by_mujoco(carried: str | None) -> None:
    scene = _odd(carried)
    assert scene.joints == ("r/slide", "r/turn", "r/lift", "r/reach", "r/roll")
    assert kinematics(scene).slides.tolist() == [True, False, False, True, False]
    _check(scene, 40)


def test_fingers_that_mimic_stay_where_the_scene_holds_them() -> None:
    scene = Scene.from_urdf(_MIMIC, tool="tip", acceleration=1.0, fingers=0.03)
    assert len(scene.joints) == 2
    _check(scene, 20)


def test_blocks_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = _odd("box")
    q, known = _random(scene, 50), kinematics(scene)
    whole = known.poses(q, known.geoms)
    monkeypatch.setattr("graceful_plan.judge.kinematics._BLOCK", 7)
    np.testing.assert_allclose(known.poses(q, known.geoms), whole, rtol=0.0, atol=1e-15)
    assert known.poses(q[:0], known.geoms).shape == (len(whole), 0, 4, 4)
    points = known.held_point(q, _POINT)
    monkeypatch.setattr("graceful_plan.judge.kinematics._POINT_BLOCK", 7)
    np.testing.assert_allclose(known.held_point(q, _POINT), points, rtol=0.0, atol=1e-15)
    assert known.held_point(q[:0], _POINT).shape == (0, 3)


def test_levers_are_distances_from_the_axes_to_the_far_side_of_bounding_spheres() -> None:
    """By the definition, geom by geom, with MuJoCo's own placement."""
    scene = _odd("box")
    q, model, placement = _random(scene, 6), scene.model, Placement(scene)
    levers, bound = _levers_near(q, scene), reach(scene)
    moved = {
        name: {b for b in range(model.nbody) if _hangs_on(model, b, int(model.joint(name).bodyid[0]))}
        for name in scene.joints
    }
    boxed = {b for b in range(model.nbody) if _hangs_on(model, b, model.body("box").id)}
    for k, configuration in enumerate(q):
        data = placement.place(configuration)
        for j, name in enumerate(scene.joints):
            joint = model.joint(name).id
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                assert levers[k, j] == 1.0
                continue
            geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in moved[name] | boxed]
            away = np.cross(data.xaxis[joint], data.geom_xpos[geoms] - data.xanchor[joint])
            lever = (np.linalg.norm(away, axis=1) + model.geom_rbound[geoms]).max() + 0.175
            assert levers[k, j] == pytest.approx(min(lever, bound[j]), abs=1e-7)


def _hangs_on(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body not in (0, root):
        body = int(model.body_parentid[body])
    return body == root

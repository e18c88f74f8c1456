"""The state of everything that is not planned: set by joint or keyframe, kept by edits, compared with keyframes."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError, UnsupportedError

_WORLD = """<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="crate" pos="0 -1 .1"><freejoint/><geom name="crate" type="box" size=".1 .1 .1" mass="1"/></body>
    <body name="wheel" pos="0 -2 .1"><joint name="wheel" type="ball"/><geom type="box" size=".1 .2 .1"/></body>
    <body name="cupboard" pos="0 1.2 .2"><geom type="box" size=".1 .1 .1"/>
      <body name="drawer"><joint name="drawer" type="slide" axis="0 -1 0" range="0 .5"/>
        <geom type="box" size=".1 .1 .1"/></body></body>
    <body name="r/base"><geom type="box" size=".05 .05 .05"/>
      <body name="r/one" pos="0 0 .2"><joint name="r/j1" axis="0 0 1" range="-2 2"/>
        <geom type="capsule" fromto=".05 0 0 .3 0 0" size=".03"/>
        <body name="r/two" pos=".4 0 0"><joint name="r/j2" axis="0 0 1" range="-2 2"/>
          <geom name="r/two" type="capsule" fromto=".05 0 0 .3 0 0" size=".03"/><site name="r/tool" pos=".4 0 0"/>
          <body name="r/jaw" pos=".3 0 0"><joint name="r/jaw" type="slide" axis="0 1 0" range="0 .05"/>
            <geom type="box" size=".02 .01 .01"/></body>
        </body></body></body>
  </worldbody>
  <keyframe>
    <key name="home" qpos=".6 .1 .2 1 0 0 0  1 0 0 0  .3  .5 -.5 .02"/>
    <key name="same" qpos="0 -1 .1 1 0 0 0  1 0 0 0  0  .5 -.5 0"/>
  </keyframe>
</mujoco>"""


def _scene(text: str = _WORLD, **changes: object) -> gp.Scene:
    given = {"robot": "r/", "tool": "r/tool", "velocity": [1.0, 1.0], "acceleration": [5.0, 5.0]} | changes
    return gp.Scene.from_mjcf(text, **given)  # type: ignore[arg-type]


def _of(scene: gp.Scene, joint: str) -> float:
    return float(scene.home_qpos[scene.model.joint(joint).qposadr[0]])


def _crate(scene: gp.Scene) -> np.ndarray:
    return scene.data_at([0.0, 0.0]).body("crate").xpos


def test_a_keyframe_sets_everything_that_is_not_planned() -> None:
    scene = _scene()
    for one in (scene.with_state(keyframe="home"), _scene(state="home")):
        np.testing.assert_allclose(_crate(one), [0.6, 0.1, 0.2])
        assert (_of(one, "drawer"), _of(one, "r/jaw")) == (0.3, 0.02)
        assert one.state_differences("home") == ()
    np.testing.assert_allclose(_crate(scene), [0.0, -1.0, 0.1])
    part = scene.with_state({"drawer": 0.1}, keyframe="home")
    assert (_of(part, "drawer"), _of(part, "r/jaw")) == (0.1, 0.02)
    assert _of(_scene(state="home", fingers=0.01), "r/jaw") == 0.01
    assert _of(_scene(fingers=0.01).with_state(keyframe="home"), "r/jaw") == 0.02


@pytest.mark.parametrize("pose", [[0.5, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0], None])
def test_what_is_placed_is_in_the_way(pose: list[float] | None) -> None:
    X = np.diag([-1.0, -1.0, 1.0, 1.0])
    X[:3, 3] = [0.5, 0.0, 0.3]
    scene = _scene()
    placed = scene.with_state({"crate": X if pose is None else pose})
    assert gp.clearance([0.0, 0.0], scene) > 0.0 > gp.clearance([0.0, 0.0], placed)
    result = gp.plan([-1.0, 0.0], [0.0, 0.0], placed, iterations=10)
    assert result.status is gp.PlanStatus.INVALID_GOAL and "crate" in result.detail
    assert gp.clearance([1.57, 0.0], scene) > 0.0 > gp.clearance([1.57, 0.0], scene.with_state({"drawer": 0.5}))


def test_ends_from_keyframes_warn_of_what_is_elsewhere(caplog: pytest.LogCaptureFixture) -> None:
    scene = _scene()
    with caplog.at_level(logging.WARNING):
        gp.plan("home", [0.0, 0.0], scene, iterations=10)
    (told,) = [record.getMessage() for record in caplog.records if "home" in record.getMessage()]
    for word in ("crate is 1.26 m", "drawer is at 0.3 instead of 0", "r/jaw is at 0.02 instead of 0", "with_state"):
        assert word in told
    for start, goal, where, count in (
        ("same", [0.0, 0.0], scene, 0),
        ("home", [0.0, 0.0], scene.with_state(keyframe="home"), 0),
        ([0.0, 0.0], "home", scene, 1),
        ([0.0, 0.0], ["home", "same"], scene, 1),
    ):
        caplog.clear()
        gp.plan(start, goal, where, iterations=10)
        assert sum("keyframe" in record.getMessage() for record in caplog.records) == count


def test_what_the_gripper_does_is_not_compared_if_it_is_given() -> None:
    told = _scene(fingers=0.01).state_differences("home")
    assert len(told) == 2 and not any("jaw" in one for one in told)
    held = _scene().attach("crate", X_TO=np.eye(4), fingers=0.01).state_differences("home")
    assert len(held) == 1 and "drawer" in held[0]


def test_edits_keep_the_state_of_everything_else() -> None:
    scene = _scene().with_state(keyframe="home")
    moved = scene.edit(move={"crate": [0.0, -3.0, 0.1]})
    for one in (moved, moved.add_box("post", [0.1] * 3, [3.0, 3.0, 0.1]), moved.with_severity({"adult": 3.0})):
        np.testing.assert_allclose(_crate(one), [0.0, -3.0, 0.1])
        assert (_of(one, "drawer"), _of(one, "r/jaw")) == (0.3, 0.02)
    gone = scene.edit(remove=["crate"])
    assert (_of(gone, "drawer"), _of(gone, "r/jaw")) == (0.3, 0.02)
    held = scene.attach("crate", X_TO=np.eye(4))
    assert _of(held, "drawer") == 0.3
    np.testing.assert_allclose(_crate(held.detach()), [0.6, 0.1, 0.2])


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"state": {"r/j1": 0.1}}, SettingError, "'r/j1'.*not planned"),
        ({"state": {"door": 0.1}}, UnknownNameError, "joint or free body 'door'; valid: .*crate.*drawer"),
        ({"state": {"drawer": 0.6}}, SettingError, "position of drawer = 0.6, expected between 0 and 0.5"),
        ({"state": {"drawer": [0.1, 0.2]}}, Exception, "state of drawer"),
        ({"state": {"crate": [0.0, 0.0, 0.0]}}, Exception, "state of crate"),
        ({"state": {"crate": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]}}, SettingError, "quaternion"),
        ({"state": {"wheel": [2.0, 0.0, 0.0, 0.0]}}, SettingError, "quaternion"),
        ({"keyframe": "away"}, UnknownNameError, "'away'; valid: home, same"),
        ({}, SettingError, "keyframe="),
    ],
)
def test_impossible_states(given: dict[str, object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        _scene().with_state(**given)  # type: ignore[arg-type]


def test_the_held_body_has_no_state_of_its_own() -> None:
    with pytest.raises(SettingError, match="gripper"):
        _scene().attach("crate", X_TO=np.eye(4)).with_state({"crate": np.eye(4)})


def test_a_keyframe_of_nameless_bodies_is_refused_only_if_it_moves_them() -> None:
    text = _WORLD.replace('<body name="crate"', "<body")
    _scene(text, state="same")
    with pytest.raises(UnsupportedError, match="without a name"):
        _scene(text, state="home")


def test_scene_files_have_states(tmp_path) -> None:
    (tmp_path / "world.xml").write_text(_WORLD)
    head = "world: world.xml\nrobot: {prefix: r/, velocity: [1, 1], acceleration: [5, 5]}\ntool: r/tool\n"
    file = tmp_path / "one.yaml"
    file.write_text(f"version: 1\n{head}state: home\n")
    assert _of(gp.load_scene(file), "drawer") == 0.3
    file.write_text(f"version: 1\n{head}state: {{drawer: 0.2, crate: [1, 1, 1, 1, 0, 0, 0]}}\n")
    np.testing.assert_allclose(_crate(gp.load_scene(file)), [1.0, 1.0, 1.0])
    assert _of(gp.load_scene(file), "drawer") == 0.2
    file.write_text(f"version: 1\n{head}state: {{drawer: 0.9}}\n")
    with pytest.raises(SceneError, match="position of drawer"):
        gp.load_scene(file)


def test_mocap_bodies_of_a_keyframe_are_compared(caplog: pytest.LogCaptureFixture) -> None:
    target = '<body name="target" mocap="true" pos="3 0 0"><geom type="box" size=".1 .1 .1"/></body>'
    text = _WORLD.replace("<worldbody>", f"<worldbody>{target}").replace(
        '<key name="home"', '<key name="home" mpos="2 1 0"'
    )
    scene = _scene(text)
    assert any("target is 1.41 m" in one for one in scene.state_differences("home"))
    assert not any("target" in one for one in scene.edit(move={"target": [2.0, 1.0, 0.0]}).state_differences("home"))
    with pytest.raises(UnsupportedError, match="mocap body 'target'"):
        scene.with_state(keyframe="home")
    assert scene.with_state(keyframe="same").state_differences("same") == ()


def test_fingers_are_finite() -> None:
    with pytest.raises(SettingError, match="position of r/jaw"):
        _scene(fingers=float("nan"))


def test_states_of_a_simulation_may_leave_soft_equalities_open(caplog: pytest.LogCaptureFixture) -> None:
    """A finger on an object: its two joints are tied, but the tie gives way."""
    text = """<mujoco><compiler angle="radian"/><worldbody>
      <body name="r"><joint name="turn" axis="0 0 1" range="-2 2"/><geom size=".05"/><site name="tip" pos=".3 0 0"/>
        <body name="near" pos=".2 0 0"><joint name="near" axis="0 1 0" range="0 2"/><geom size=".02"/>
          <body name="far" pos=".1 0 0"><joint name="far" axis="0 1 0" range="0 2"/><geom size=".02"/></body>
        </body></body></worldbody>
      <tendon><fixed name="tie"><joint joint="near" coef="1"/><joint joint="far" coef="-1"/></fixed></tendon>
      <equality><tendon tendon1="tie"/></equality>
      <actuator><position joint="near"/></actuator>
      <keyframe><key name="settled" qpos="0 .7 .1"/></keyframe></mujoco>"""
    scene = gp.Scene.from_mjcf(text, robot="r", tool="tip", velocity=[1.0], acceleration=[5.0], state="settled")
    assert scene.home_qpos.tolist() == [0.0, 0.7, 0.1]
    assert "stay open by 0.6" in caplog.text
    np.testing.assert_allclose(scene.with_state({"near": 0.4, "far": 0.4}).home_qpos, [0.0, 0.4, 0.4])
    closed = gp.Scene.from_mjcf(text, robot="r", tool="tip", velocity=[1.0], acceleration=[5.0], state={"near": 0.7})
    np.testing.assert_allclose(closed.home_qpos, [0.0, 0.7, 0.7], atol=1e-6)

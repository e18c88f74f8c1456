from __future__ import annotations

import dataclasses
import gc
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from places import LIBRARY

from graceful_plan.exceptions import (
    NonFiniteError,
    SceneError,
    SettingError,
    ShapeError,
    UnknownNameError,
    UnsupportedError,
)
from graceful_plan.scene.elements import AllowedContact, EntityAnnotation, Granular, Liquid
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.loading.file import read_scene
from graceful_plan.scene.roles import FROM_ABOVE
from graceful_plan.scene.scene import Scene

_ARM = """<mujoco model="workshop">
  <compiler angle="radian"/>
  <custom>
    <numeric name="six/velocity_limit" data="1 1 1 2 2 2"/>
    <numeric name="six/acceleration_limit" data="5 5 5 9 9 9"/>
    <text name="entity/monitor" data="laptop"/>
  </custom>
  <worldbody>
    <geom name="ground" type="plane" size="3 3 0.1"/>
    <body name="bench" pos="0.6 0 0.1"><geom name="top" type="box" size="0.2 0.3 0.1"/>
      <body name="monitor" pos="0 0.2 0.2"><geom name="screen" type="box" size="0.02 0.1 0.1"/></body></body>
    <body name="cup" pos="0.6 -0.1 0.25"><freejoint name="cup"/>
      <geom name="cup" type="cylinder" size="0.03 0.05" mass="0.3"/>
      <geom name="cup_contents" type="cylinder" size="0.025 0.04" mass="0.1" contype="0" conaffinity="0"/></body>
    <body name="jar" pos="0.6 0.05 0.25"><geom name="jar" type="sphere" size="0.05" mass="1.5"/></body>
    <body name="door" pos="-1 0 0.5"><joint name="hinge" axis="0 0 1"/><geom name="door" size="0.1"/></body>
    <body name="six/pedestal"><geom name="six/pedestal" type="cylinder" size="0.08 0.1" pos="0 0 0.1"/>
      <body name="six/a" pos="0 0 0.3"><joint name="six/j1" axis="0 0 1" range="-3 3" limited="true"/>
        <geom name="six/a" type="capsule" fromto="0 0 0 0 0 0.1" size="0.05"/>
        <body name="six/b" pos="0 0 0.1"><joint name="six/j2" axis="0 1 0" range="-2 2" limited="true"/>
          <geom name="six/b" type="capsule" fromto="0 0 0.1 0 0 0.3" size="0.04"/>
          <body name="six/c" pos="0 0 0.4"><joint name="six/j3" axis="0 1 0" range="-2.5 2.5" limited="true"/>
            <geom name="six/c" type="capsule" fromto="0.05 0 0 0.25 0 0" size="0.04"/>
            <body name="six/d" pos="0.3 0 0"><joint name="six/j4" axis="1 0 0"/>
              <geom name="six/d" type="ellipsoid" size="0.05 0.04 0.04"/>
              <body name="six/e" pos="0.1 0 0"><joint name="six/j5" axis="0 1 0" range="-2 2" limited="true"/>
                <geom name="six/e" type="sphere" size="0.04"/>
                <body name="six/f" pos="0.08 0 0"><joint name="six/j6" axis="1 0 0" range="-3 3" limited="true"/>
                  <geom name="six/f" type="box" size="0.03 0.03 0.03"/>
                  <site name="six/tip" pos="0.1 0 0" euler="0 1.5707963267948966 0"/>
                  <body name="six/jaw"><joint name="six/jaw" type="slide" axis="0 1 0" range="0 0.05" limited="true"/>
                    <geom name="six/jaw" type="box" size="0.04 0.005 0.01" pos="0.05 0 0"/></body>
                </body></body></body></body></body></body></body>
  </worldbody>
  <contact><exclude body1="six/pedestal" body2="six/a"/></contact>
  <actuator>
    <motor joint="six/j1" forcerange="-40 50" forcelimited="true" gear="2"/><motor joint="six/j2"/>
  </actuator>
  <keyframe><key name="elbow_up" qpos="0.6 -0.1 0.25 1 0 0 0 0 0.1 0.2 0.3 0.4 0.5 0.6 0.01"/></keyframe>
</mujoco>"""
_NQ = 6


def _workshop(**changes: object) -> Scene:
    given = {"robot": "six/", "tool": "six/tip", "entities": {"bench": "table", "cup": "glass"}} | changes
    given = ({"X_TO": FROM_ABOVE} if "carried" in changes else {}) | given
    return Scene.from_mjcf(changes.pop("source", _ARM), **{k: v for k, v in given.items() if k != "source"})  # type: ignore[arg-type]


# --- any arm ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("actuators", "most"),
    [
        ('<motor joint="six/j1" ctrlrange="-30 80" gear="2"/>', 160.0),
        ('<motor joint="six/j1" ctrlrange="-80 80" forcerange="-50 50"/>', 50.0),
        ('<motor joint="six/j1" ctrlrange="-3 3"/><motor joint="six/j1" ctrlrange="-4 4"/>', 7.0),
        ('<general joint="six/j1" ctrlrange="-1 1" gainprm="87"/>', 87.0),
        ('<position joint="six/j1" ctrlrange="-3 3" kp="9"/>', np.inf),  # its command is a position
        ('<general joint="six/j1" ctrlrange="-1 1" gainprm="9" dyntype="integrator" actrange="-5 5"/>', np.inf),
        ('<motor joint="six/j1"/>', np.inf),
    ],
)
def test_torque_limits_come_from_forces_and_from_the_commands_of_motors(actuators: str, most: float) -> None:
    source = re.sub("<actuator>.*</actuator>", f"<actuator>{actuators}</actuator>", _ARM, flags=re.DOTALL)
    assert _workshop(source=source).limits.torque[0] == pytest.approx(most)


def test_another_arm_works() -> None:
    scene = _workshop(keyframes={"zero": [0.0] * 6})
    assert scene.name == "workshop"
    assert scene.joints == ("six/j1", "six/j2", "six/j3", "six/j4", "six/j5", "six/j6")
    assert scene.qpos_adr.tolist() == [8, 9, 10, 11, 12, 13]
    limits = scene.limits
    np.testing.assert_allclose(limits.position[[0, 3, 5]], [[-3, 3], [-2 * np.pi, 2 * np.pi], [-3, 3]])
    np.testing.assert_allclose(limits.velocity, [1, 1, 1, 2, 2, 2])
    np.testing.assert_allclose(limits.acceleration, [5, 5, 5, 9, 9, 9])
    np.testing.assert_allclose(limits.torque, [100.0] + [np.inf] * 5)
    np.testing.assert_allclose(scene.keyframes["elbow_up"], [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    np.testing.assert_allclose(scene.keyframes["zero"], np.zeros(6))
    assert {e.name: e.category for e in scene.entities.values()} == {
        "monitor": "laptop",
        "bench": "table",
        "cup": "glass",
    }
    assert set(scene.unlabelled) == {"world", "jar", "door"}


def test_kinematics_of_another_arm_are_those_of_its_model() -> None:
    # All joints at zero: straight up to the elbow, then along x; the tool looks along x.
    data = _workshop().data_at(np.zeros(_NQ))
    np.testing.assert_allclose(data.site("six/tip").xpos, [0.3 + 0.1 + 0.08 + 0.1, 0.0, 0.8], atol=1e-12)
    np.testing.assert_allclose(data.site("six/tip").xmat.reshape(3, 3)[:, 2], [1.0, 0.0, 0.0], atol=1e-12)


def test_the_tool_may_be_named_by_a_body() -> None:
    scene, by_site = _workshop(tool="six/a", velocity=[1.0], acceleration=[5.0], keyframes={}), _workshop()
    assert scene.tool == "six/a" and scene.joints == by_site.joints[: len(scene.joints)]
    data = scene.data_at(np.full(len(scene.joints), 0.3))
    np.testing.assert_allclose(data.site("six/a").xpos, data.body("six/a").xpos, atol=1e-12)
    np.testing.assert_allclose(data.site("six/a").xmat, data.body("six/a").xmat, atol=1e-12)
    assert scene.add_box("crate", [0.1] * 3, [2.0, 2.0, 2.0]).tool == "six/a"


def test_limits_replace_those_of_the_model_everywhere() -> None:
    given = {"six/j1": (-0.5, 0.7), "six/j4": (-1.0, 1.0), "six/jaw": (0.0, 0.2)}
    scene = _workshop(limits=given, fingers=0.1)
    np.testing.assert_allclose(scene.limits.position[[0, 3]], [[-0.5, 0.7], [-1.0, 1.0]])
    assert _workshop().endless[3] and not scene.endless[3]
    later = scene.add_box("crate", [0.1] * 3, [2.0, 2.0, 2.0]).edit(move={"crate": [2.0, 2.0, 1.0]})
    np.testing.assert_array_equal(later.limits.position, scene.limits.position)
    assert tuple(later.model.joint("six/j1").range) == (-0.5, 0.7)


def test_a_robot_may_be_named_by_its_root_body() -> None:
    by_prefix, by_root = _workshop(), _workshop(robot="six/pedestal")
    assert by_root.robot_bodies == by_prefix.robot_bodies
    np.testing.assert_array_equal(by_root.limits.velocity, by_prefix.limits.velocity)


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"robot": "seven/"}, UnknownNameError, r"unknown robot prefix or root body 'seven/'; valid: bench, .*six/"),
        ({"robot": ""}, UnknownNameError, "unknown robot prefix or root body ''"),
        (
            {"tool": "six/tap"},
            UnknownNameError,
            r"unknown tool \(site or body\) 'six/tap'; valid: six/a, .*six/pedestal, six/tip",
        ),
        ({"limits": {"six/j9": (0.0, 1.0)}}, UnknownNameError, "unknown joint 'six/j9'; valid: six/j1, .*six/jaw"),
        ({"limits": {"six/j1": (1.0, 0.0)}}, SettingError, r"limits of six/j1 = \(1.0, 0.0\), expected two finite"),
        ({"entities": {"spoon": "robust"}}, UnknownNameError, r"unknown entity \(body\) 'spoon'; valid: .*cup"),
        ({"entities": {"cup": "china"}}, UnknownNameError, "unknown entity class 'china'; valid: adult, .*glass"),
        ({"entities": {"six/b": "robust"}}, SceneError, "the entity 'six/b' is part of the robot"),
        ({"body_class": "fall"}, UnknownNameError, "class of component 'body' 'fall'; valid: arm_braked, arm_collapse"),
        ({"body_class": "base_coast"}, SceneError, "no severity of 'base_coast' against 'table'"),
        ({"velocity": [1.0, 2.0]}, SettingError, r"velocity limits = \[1.0, 2.0\], expected 6 finite numbers above 0"),
        ({"velocity": [1.0] * 5 + [-1.0]}, SettingError, "velocity limits = "),
        ({"fingers": 0.2}, SettingError, "position of six/jaw = 0.2, expected between 0 and 0.05"),
        ({"fingers": {"six/j1": 0.2}}, UnknownNameError, "unknown finger joint 'six/j1'; valid: six/jaw"),
        ({"keyframes": {"a": [0.0] * 5}}, ShapeError, r"keyframe 'a' has shape \(5,\), expected \(6,\)"),
        ({"keyframes": {"a": [9.0] * 6}}, SettingError, "joint 0 of keyframe 'a' = 9.0, expected between -3 and 3"),
        ({"keyframes": {"a": [float("nan")] * 6}}, NonFiniteError, "keyframe a is not finite"),
        (
            {"severity": {"bowl": 3.0}},
            UnknownNameError,
            r"unknown entity or entity class 'bowl'; valid: .*bench.*table",
        ),
        ({"severity": {"cup": -3.0}}, SettingError, "severity of cup = -3.0"),
        (
            {"severity": {"cup": {"arm": 3.0}}},
            UnknownNameError,
            "unknown component or component class 'arm'; valid: .*base_coast, body, carried, cold, contents, ",
        ),
        ({"carried": "monitor"}, UnsupportedError, "'monitor' is attached to another body"),
        ({"carried": "door"}, UnsupportedError, "'door' has joints of its own"),
        ({"carried": "six/pedestal"}, UnsupportedError, "'six/pedestal' is part of the robot"),
        (
            {"carried": "mug"},
            UnknownNameError,
            "unknown object or body that can be held 'mug'; valid: bench, cup, door, jar",
        ),
        (
            {"carried": "cup", "X_TO": np.zeros((4, 4))},
            SettingError,
            "X_TO = .*, expected a 4 x 4 matrix of a rotation",
        ),
        ({"carried": "cup", "X_TO": np.eye(3)}, ShapeError, "X_TO has shape"),
        (
            {"carried": "jar", "contents": Granular(0.1)},
            UnknownNameError,
            "geom for the contents of 'jar' 'jar_contents'",
        ),
        ({"allowed_contacts": [AllowedContact("cup", "moon")]}, UnknownNameError, "unknown body or geom 'moon'"),
        ({"source": "arm.xml"}, SceneError, "arm.xml: cannot be read"),
    ],
)
def test_misuse_is_refused_by_name(changes: dict, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        _workshop(**changes)


@pytest.mark.parametrize(
    ("old", "new", "error", "words"),
    [
        (
            "six/velocity_limit",
            "x",
            SceneError,
            r"no velocity limits: give velocity=\[6 numbers\].*'six/velocity_limit'",
        ),
        ('data="5 5 5 9 9 9"', 'data="5 5"', SettingError, r"acceleration limits = \[5.0, 5.0\]"),
        ('name="six/j1"', 'name="six/j1" type="ball"', SceneError, "."),
        (
            'range="-2 2" limited="true"/>\n          <g',
            'type="slide"/>\n          <g',
            SceneError,
            "'six/j2' has no range",
        ),
        ('data="laptop"', 'data="tablet"', UnknownNameError, "unknown entity class 'tablet'"),
        (
            'size="0.02 0.1 0.1"',
            'size="0.02 0.1 0.1" contype="0" conaffinity="0"',
            SceneError,
            "'monitor' has no geoms",
        ),
        ('<site name="six/tip"', '<body name="six/t"><site name="six/u"/></body><site name="six/tip"', None, ""),
    ],
)
def test_other_models(old: str, new: str, error: type[Exception] | None, words: str) -> None:
    assert old in _ARM
    source = _ARM.replace(old, new)
    if error is None:
        assert _workshop(source=source).joints[0] == "six/j1"
    else:
        with pytest.raises(error, match=words):
            _workshop(source=source)


def test_a_free_flying_robot_is_refused() -> None:
    source = _ARM.replace('<body name="six/pedestal">', '<body name="six/pedestal"><freejoint name="six/fly"/>')
    source = source[: source.index("<keyframe>")] + "</mujoco>"
    with pytest.raises(UnsupportedError, match="six/fly"):
        _workshop(source=source)


def test_a_robot_that_does_not_move_is_refused() -> None:
    source = _ARM.replace('<body name="six/a"', '<site name="six/base"/><body name="six/a"')
    with pytest.raises(SceneError, match="'six/pedestal'"):
        _workshop(source=source, tool="six/base")


def test_a_tool_on_something_else_is_refused() -> None:
    source = _ARM.replace('<geom name="door"', '<site name="knob"/><geom name="door"')
    with pytest.raises(SceneError, match="'door'"):
        _workshop(source=source, tool="knob")


def test_a_spec_is_copied() -> None:
    spec = mujoco.MjSpec.from_string(_ARM)
    scene = _workshop(source=spec).add_box("crate", [0.1, 0.1, 0.1], [1.0, 1.0, 0.1])
    assert spec.body("crate") is None
    assert scene.model.body("crate").id > 0


# --- components and entities ------------------------------------------------------------------------------------------


def _labels(scene: Scene, geoms: tuple[int, ...]) -> set[str]:
    return {scene.model.geom(g).name for g in geoms}


def test_entities_have_the_geoms_of_their_subtree_less_other_entities() -> None:
    scene = _workshop()
    assert _labels(scene, scene.entities["bench"].geoms) == {"top"}
    assert _labels(scene, scene.entities["monitor"].geoms) == {"screen"}
    merged = _workshop(source=_ARM.replace('name="entity/monitor"', 'name="note"'))
    assert _labels(merged, merged.entities["bench"].geoms) == {"top", "screen"}


def test_the_body_component_consists_of_moving_links() -> None:
    scene = _workshop()
    assert _labels(scene, scene.components["body"].geoms) == {f"six/{x}" for x in "abcdef"} | {"six/jaw"}
    assert scene.components["body"].component_class == "arm_collapse"
    assert scene.carried is None and scene.contents is None
    assert set(scene.components) == {"body"}


def test_severities_come_from_the_table() -> None:
    scene = _workshop(carried="cup", contents=Liquid(0.2, temperature=80.0))
    table = SeverityTable.shipped()
    assert scene.entities["monitor"].severity == {
        "body": table.severity("laptop", "arm_collapse"),
        "carried": table.severity("laptop", "medium"),
        "contents": table.severity("laptop", "hot"),
    }
    assert "cup" not in scene.entities


def test_severities_can_be_replaced_at_every_level() -> None:
    note = EntityAnnotation(category="table", severity={"body": 7.0})
    scene = _workshop(entities={"bench": note, "cup": "glass"}, severity={"table": {"medium": 3.0}}, carried="cup")
    assert scene.entities["bench"].severity == {"body": 7.0, "carried": 3.0}
    changed = scene.with_severity({"bench": 9.0, "laptop": {"arm_collapse": 1.0}})
    assert changed.entities["bench"].severity == {"body": 9.0, "carried": 9.0}
    assert changed.entities["monitor"].severity["body"] == 1.0
    assert scene.entities["bench"].severity == {"body": 7.0, "carried": 3.0}
    assert changed.model is scene.model
    table = SeverityTable.shipped().with_overrides({"laptop": 0.5})
    assert changed.with_severity(table).entities["monitor"].severity == {"body": 1.0, "carried": 0.5}


def test_severities_by_component_class_hold_for_any_object() -> None:
    row = {"arm_collapse": 7.0, "light": 1.5, "medium": 2.5, "hot": 6.0}
    scene = _workshop(entities={"bench": "table", "cup": "glass"}, severity={"bench": row})
    assert scene.entities["bench"].severity == {"body": 7.0}
    full = scene.attach("cup", X_TO=FROM_ABOVE, contents=Liquid(0.2, temperature=80.0), object_class="light")
    assert full.entities["bench"].severity == {"body": 7.0, "carried": 1.5, "contents": 6.0}
    assert scene.attach("cup", X_TO=FROM_ABOVE).entities["bench"].severity == {"body": 7.0, "carried": 2.5}
    heavy = (
        scene.attach("cup", X_TO=FROM_ABOVE, object_class="heavy").entities["bench"].severity
    )  # not in the row: from the table
    assert heavy == {"body": 7.0, "carried": SeverityTable.shipped().severity("table", "heavy")}
    both = scene.with_severity({"bench": {"body": 3.0, "arm_collapse": 4.0}})
    assert both.entities["bench"].severity == {"body": 3.0}


def test_a_later_severity_by_class_replaces_a_number_of_the_entity() -> None:
    note = EntityAnnotation(category="table", severity=9.0)
    scene = _workshop(entities={"bench": note, "cup": "glass"}, severity={"bench": {"medium": 2.5}}, carried="cup")
    assert scene.entities["bench"].severity == {"body": 9.0, "carried": 2.5}


def test_a_severity_file_can_be_given(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text("version: 1\ncomponents: [arm_collapse]\nentities: {table: [3], glass: [4], laptop: [5]}\n")
    scene = _workshop(severity=file)
    assert [e.severity["body"] for e in scene.entities.values()] == [5.0, 3.0, 4.0]


# --- carrying ---------------------------------------------------------------------------------------------------------


def _pose(data: mujoco.MjData, body: str) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = data.body(body).xmat.reshape(3, 3), data.body(body).xpos
    return X


def _tool(data: mujoco.MjData, site: str) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = data.site(site).xmat.reshape(3, 3), data.site(site).xpos
    return X


@pytest.mark.parametrize("body", ["cup", "jar"])
def test_the_carried_object_moves_with_the_tool(body: str) -> None:
    X_TO = np.array([[0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.03], [0, 0, 0, 1]], dtype=float)
    scene = _workshop(carried=body, X_TO=X_TO)
    rng = np.random.default_rng(0)
    for _ in range(20):
        data = scene.data_at(rng.uniform(-2, 2, _NQ))
        np.testing.assert_allclose(_pose(data, body), _tool(data, "six/tip") @ X_TO, atol=1e-9)
    assert scene.model.body(body).jntnum[0] == 1


def test_by_default_things_hang_upright_from_a_tool_that_points_down(scene: Scene) -> None:
    q = scene.keyframes["ready"]
    data = scene.attach("white1", X_TO=FROM_ABOVE).data_at(q)
    np.testing.assert_allclose(_pose(data, "white1")[:3, 2], [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(_pose(data, "white1")[:3, 3], _tool(data, "panda/tool")[:3, 3], atol=1e-12)


def test_attaching_and_detaching() -> None:
    scene = _workshop()
    holding = scene.attach("cup", X_TO=FROM_ABOVE, support=["bench"])
    assert holding.carried is not None
    assert (holding.carried.body, holding.carried.object_class) == ("cup", "medium")
    assert _labels(holding, holding.components["carried"].geoms) == {"cup"}
    assert holding.model is scene.model  # it has a free joint already
    with pytest.raises(SceneError, match=r"'cup'.*detach\(\)"):
        holding.attach("jar", X_TO=FROM_ABOVE)
    empty = holding.detach()
    assert empty.carried is None
    assert set(empty.entities) == set(scene.entities)
    assert not empty.allowed_contacts
    np.testing.assert_array_equal(empty.home_qpos, scene.home_qpos)
    with pytest.raises(SceneError, match="gripper"):
        empty.detach()


def test_a_thing_without_a_free_joint_gets_one() -> None:
    scene = _workshop()
    holding = scene.attach("jar", X_TO=FROM_ABOVE)
    assert holding.model.nq == scene.model.nq + 7
    assert scene.model.body("jar").jntnum[0] == 0
    assert holding.joints == scene.joints
    np.testing.assert_allclose(holding.data_at(np.zeros(_NQ)).site("six/tip").xpos[2], 0.8)
    assert holding.carried is not None and holding.carried.object_class == "heavy"
    np.testing.assert_allclose(holding.keyframes["elbow_up"], scene.keyframes["elbow_up"])


@pytest.mark.parametrize(("mass", "word"), [("0.05", "light"), ("0.2", "medium"), ("0.9", "medium"), ("1.1", "heavy")])
def test_the_class_of_an_object_goes_by_its_mass(mass: str, word: str) -> None:
    scene = _workshop(source=_ARM.replace('mass="1.5"', f'mass="{mass}"'), carried="jar")
    assert scene.components["carried"].component_class == word


def test_the_class_of_an_object_can_be_given() -> None:
    assert (
        _workshop().attach("jar", X_TO=FROM_ABOVE, object_class="sharp").components["carried"].component_class
        == "sharp"
    )
    with pytest.raises(UnknownNameError, match=r"'blunt'.*glass, heavy, light, medium, sharp"):
        _workshop().attach("jar", X_TO=FROM_ABOVE, object_class="blunt")


def test_contents_have_geoms_of_their_own() -> None:
    scene = _workshop(carried="cup", contents=Liquid(0.25, temperature=85.0))
    assert _labels(scene, scene.components["contents"].geoms) == {"cup_contents"}
    assert _labels(scene, scene.components["carried"].geoms) == {"cup"}
    assert scene.contents == Liquid(0.25, temperature=85.0)
    named = _workshop(carried="cup", contents=Granular(0.25, geoms=("cup_contents",)))
    assert named.components["contents"].component_class == "dry"
    with pytest.raises(SceneError, match="'carried'"):
        _workshop(carried="cup", contents=Granular(0.25, geoms=("cup", "cup_contents")))


@pytest.mark.parametrize(
    ("contents", "word"),
    [
        (Liquid(1.0), "cold"),
        (Liquid(1.0, temperature=59.0), "cold"),
        (Liquid(1.0, temperature=60.0), "hot"),
        (Liquid(1.0, temperature=180.0, kind="oil"), "oil"),
        (Liquid(1.0, kind="oil"), "cold"),
        (Granular(1.0), "dry"),
    ],
)
def test_classes_of_contents(contents: Liquid | Granular, word: str) -> None:
    assert contents.component_class == word


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Liquid(0.0), "volume = 0.0"),
        (lambda: Liquid(float("nan")), "volume = nan"),
        (lambda: Granular(-1.0), r"volume = -1\.0"),
        (lambda: Liquid(1.0, temperature=float("inf")), "temperature = inf"),
        (lambda: Liquid(1.0, kind="acid"), "kind = 'acid', expected 'water' or 'oil'"),
    ],
)
def test_impossible_contents(make: object, words: str) -> None:
    with pytest.raises(SettingError, match=words):
        make()  # type: ignore[operator]


def test_fingers_open_as_far_as_the_object_needs() -> None:
    scene = _workshop(fingers=0.01)
    jaw = int(scene.model.joint("six/jaw").qposadr[0])
    assert scene.home_qpos[jaw] == 0.01
    holding = scene.attach("cup", X_TO=FROM_ABOVE, fingers={"six/jaw": 0.03})
    assert holding.home_qpos[jaw] == 0.03
    assert holding.detach().home_qpos[jaw] == 0.01


# --- contacts ---------------------------------------------------------------------------------------------------------


def test_gripper_and_supports_may_touch_the_object() -> None:
    scene = _workshop(carried="cup", allowed_contacts=[AllowedContact("jar", "six/f")])
    holding = scene.detach().attach("cup", X_TO=FROM_ABOVE, support=["bench"])
    assert holding.allowed_contacts == (
        AllowedContact("jar", "six/f", "always"),
        AllowedContact("six/f", "cup", "always"),
        AllowedContact("six/jaw", "cup", "always"),
        AllowedContact("cup", "bench", "ends"),
    )
    pairs = {frozenset(_labels(holding, tuple(pair))) for pair in holding.collision_pairs().tolist()}
    assert frozenset({"cup", "six/f"}) not in pairs
    assert frozenset({"jar", "six/f"}) not in pairs
    assert {frozenset({"cup", "six/e"}), frozenset({"cup", "top"}), frozenset({"cup", "ground"})} <= pairs
    assert holding.allowed_pairs("ends") == {
        tuple(sorted((holding.model.geom("cup").id, g))) for g in holding.geoms_named("bench")
    }
    with pytest.raises(UnknownNameError, match="'shelf'"):
        scene.detach().attach("cup", X_TO=FROM_ABOVE, support=["shelf"])


@pytest.mark.parametrize("name", ["tabletop_l1", "tabletop", "tabletop_l3"])
def test_contacts_of_random_configurations_are_among_the_pairs(name: str) -> None:
    scene = load_scene(name).attach("green")
    pairs = {tuple(sorted(pair)) for pair in scene.collision_pairs().tolist()} | scene.allowed_pairs("always")
    mine = scene.robot_bodies | {scene.model.body("green").id}
    rng = np.random.default_rng(0)
    seen = set()
    for q in rng.uniform(*scene.limits.position.T, (300, 7)):
        data = scene.data_at(q)
        mujoco.mj_collision(scene.model, data)
        touching = {(min(a, b), max(a, b)) for a, b in data.contact.geom.tolist()}
        seen |= {(a, b) for a, b in touching if {int(scene.model.geom_bodyid[g]) for g in (a, b)} & mine}
    assert len(seen) > 50
    assert seen <= pairs


def test_pairs_and_poses_cannot_be_written_to(scene: Scene) -> None:
    task = scene.tasks["lift_to_goal"]
    assert task.scene.carried is not None
    limits = scene.limits
    for array in (
        scene.collision_pairs(),
        scene.keyframes["lift"],
        scene.home_qpos,
        scene.qpos_adr,
        limits.position,
        limits.velocity,
        limits.acceleration,
        limits.torque,
        task.goal,
        task.start,
        task.scene.carried.X_TO,
        scene.attach("white1", X_TO=FROM_ABOVE).carried.X_TO,  # type: ignore[union-attr]
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


# --- adding things ----------------------------------------------------------------------------------------------------


def test_things_can_be_added() -> None:
    scene = _workshop()
    X = np.array([[0, -1, 0, 1.0], [1, 0, 0, 2.0], [0, 0, 1, 3.0], [0, 0, 0, 1]], dtype=float)
    tetrahedron = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
    added = (
        scene.add_box("crate", [0.1, 0.2, 0.3], X, entity="robust")
        .add_sphere("ball", 0.1, [1.0, 1.0, 1.0])
        .add_cylinder("can", 0.1, 0.2, [1.0, 1.0, 1.5], entity="glass")
        .add_capsule("pill", 0.1, 0.2, [1.0, 1.0, 2.0])
        .add_mesh("wedge", tetrahedron, [2.0, 0.0, 0.0], entity="heirloom")
    )
    assert "crate" not in scene.entities
    assert {n: added.entities[n].category for n in ("crate", "can", "wedge")} == {
        "crate": "robust",
        "can": "glass",
        "wedge": "heirloom",
    }
    assert {"ball", "pill"} <= set(added.unlabelled)
    model, data = added.model, added.data_at(np.zeros(_NQ))
    np.testing.assert_allclose(_pose(data, "crate"), X, atol=1e-12)
    np.testing.assert_allclose(model.geom("crate").size, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(model.geom("can").size[:2], [0.1, 0.2])
    mesh = model.geom("wedge").dataid[0]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    local = model.mesh_vert[start : start + count]
    geom = data.geom("wedge")
    corners = local @ geom.xmat.reshape(3, 3).T + geom.xpos
    expected = np.add(tetrahedron, [2.0, 0.0, 0.0])
    distance = np.linalg.norm(corners[:, None] - expected[None], axis=-1)
    assert distance.min(axis=0).max() < 1e-6
    first = {added.model.geom(int(g)).name for g in added.collision_pairs()[:, 1]}
    assert {"crate", "ball", "can", "pill", "wedge"} <= first
    assert added.attach("crate", X_TO=FROM_ABOVE).components["carried"].component_class == "heavy"


@pytest.mark.parametrize(
    ("add", "error", "words"),
    [
        (lambda s: s.add_box("cup", [1, 1, 1], [0, 0, 0]), SceneError, "the name 'cup' is taken"),
        (lambda s: s.add_box("", [1, 1, 1], [0, 0, 0]), SceneError, "the name '' is empty"),
        (lambda s: s.add_box("x", [1, 1], [0, 0, 0]), ShapeError, "size of x has shape"),
        (lambda s: s.add_box("x", [1, 1, 0], [0, 0, 0]), SettingError, "expected lengths above 0"),
        (lambda s: s.add_sphere("x", float("nan"), [0, 0, 0]), NonFiniteError, "size of x is not finite"),
        (lambda s: s.add_sphere("x", 1.0, [0, 0]), ShapeError, "pose of x has shape"),
        (lambda s: s.add_sphere("x", 1.0, [0, float("inf"), 0]), NonFiniteError, "pose of x is not finite"),
        (lambda s: s.add_sphere("x", 1.0, -np.eye(4)), SettingError, "a 4 x 4 matrix of a rotation"),
        (lambda s: s.add_sphere("x", 1.0, [0, 0, 0], entity="rock"), UnknownNameError, "unknown entity class 'rock'"),
        (lambda s: s.add_mesh("x", np.zeros((2, 3)), [0, 0, 0]), SceneError, "the vertices of 'x' have no volume"),
        (lambda s: s.add_mesh("x", np.eye(4)[:, :3] * [1, 1, 0], [0, 0, 0]), SceneError, "have no volume"),
    ],
)
def test_impossible_things_cannot_be_added(add: object, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        add(_workshop())  # type: ignore[operator]


# --- the scene as an object -------------------------------------------------------------------------------------------


def test_a_configuration_has_the_right_shape(scene: Scene) -> None:
    with pytest.raises(ShapeError, match="q has shape"):
        scene.data_at([0.0] * 6)
    with pytest.raises(NonFiniteError, match=r"q .*finite"):
        scene.data_at([np.nan] * 7)


def test_the_table_of_fields_is_true() -> None:
    table = re.findall(r"^    \| (\w+) +\|", SceneFacts.__doc__ or "", flags=re.MULTILINE)
    assert table[1:] == [field.name for field in dataclasses.fields(Scene)]


def test_scenes_are_equal_only_to_themselves(scene: Scene) -> None:
    other = read_scene(LIBRARY / "scene" / "scenes" / "tabletop.yaml")
    assert scene == scene.tasks["lift_to_goal"].world
    assert scene != other
    assert len({scene, other}) == 2
    with pytest.raises(AttributeError):
        scene.model = other.model  # type: ignore[misc]


def test_a_summary_names_everything() -> None:
    scene = (
        _workshop(carried="cup", contents=Liquid(0.25, temperature=85.0))
        .detach()
        .attach("cup", X_TO=FROM_ABOVE, support=["bench"])
    )
    text = scene.describe()
    for words in ("'workshop'", "arm_collapse", "bench", "table", "monitor", "laptop", "jar", "cup - bench (ends)",
                  "six/jaw - cup (always)", "elbow_up"):  # fmt: skip
        assert words in text


def test_scenes_are_freed() -> None:
    import weakref

    scene = read_scene(LIBRARY / "scene" / "scenes" / "tabletop.yaml")  # fresh: load_scene caches its own
    watched = [weakref.ref(scene), weakref.ref(scene.tasks["lift_to_goal"].scene)]
    del scene
    gc.collect()
    assert [ref() for ref in watched] == [None, None]


# --- grasps -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cup", "jar"])
def test_an_object_stays_where_it_is_relative_to_the_tool(name: str) -> None:
    scene, q = _workshop(), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    before = scene.data_at(q)
    held = scene.attach(name, at=q)
    for one in (held, scene.attach(name, at="elbow_up"), _workshop(carried=name, at=q, X_TO=None)):
        np.testing.assert_allclose(one.data_at(q).body(name).xpos, before.body(name).xpos, atol=1e-12)
        np.testing.assert_allclose(one.data_at(q).body(name).xmat, before.body(name).xmat, atol=1e-12)
    other = held.data_at(np.zeros(_NQ))
    R = other.site("six/tip").xmat.reshape(3, 3)
    p = R.T @ (other.body(name).xpos - other.site("six/tip").xpos)
    np.testing.assert_allclose(p, held.carried.X_TO[:3, 3], atol=1e-12)  # type: ignore[union-attr]


def test_an_object_in_another_state_is_held_from_there() -> None:
    scene = _workshop().with_state({"cup": [0.4, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0]})
    held = scene.attach("cup", at=np.zeros(_NQ)).data_at(np.zeros(_NQ))
    np.testing.assert_allclose(held.body("cup").xpos, [0.4, 0.1, 0.3], atol=1e-12)
    np.testing.assert_allclose(held.body("cup").xmat.reshape(3, 3), np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_a_grasp_has_to_be_given() -> None:
    scene = _workshop()
    with pytest.raises(SettingError, match=r"grasp of 'cup'.*at=.*FROM_ABOVE"):
        scene.attach("cup")
    with pytest.raises(SettingError, match="one of at and X_TO"):
        scene.attach("cup", at=np.zeros(_NQ), X_TO=FROM_ABOVE)
    with pytest.raises(ShapeError):
        scene.attach("cup", at=[0.0])
    with pytest.raises(UnknownNameError, match="'elbow_down'; valid: elbow_up"):
        scene.attach("cup", at="elbow_down")

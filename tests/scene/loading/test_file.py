from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from graceful_plan.exceptions import GracefulPlanError, SceneError, UnknownNameError, UnsupportedError
from graceful_plan.scene.elements import AllowedContact, Granular, Liquid
from graceful_plan.scene.loading.file import read_scene
from graceful_plan.scene.roles import FROM_ABOVE
from graceful_plan.scene.scene import Scene

_WORLD = """<mujoco><worldbody>
<geom name="floor" type="plane" size="2 2 0.1"/>
<body name="shelf" pos="0.5 0 0.2"><geom name="shelf" type="box" size="0.1 0.3 0.02"/></body>
<body name="cup" pos="0.5 0 0.27"><freejoint/><geom name="cup" type="cylinder" size="0.03 0.05"/>
  <geom name="tea" type="cylinder" size="0.02 0.04" contype="0" conaffinity="0"/></body>
<body name="vase" pos="0.5 0.2 0.3"><geom name="vase" type="sphere" size="0.08"/></body>
</worldbody></mujoco>"""

_SCENE = """version: 1
description: A cup of tea on a shelf.
world: world.xml
robot:
  model: panda
  position: [0, 0, 0.1]
  quaternion: [0, 0, 0, 1]
fingers: 0.04
entities:
  shelf: table
  vase: {class: heirloom, severity: {carried: 33}}
  cup: glass
severity:
  table: {medium: 1.5}
objects:
  tea:
    body: cup
    class: medium
    grasp: {position: [0, 0, 0.02], quaternion: [0, 1, 0, 0]}
    fingers: {panda/finger_joint1: 0.03, panda/finger_joint2: 0.03}
    contents: {kind: water, volume: 0.2, temperature: 85, geoms: [tea]}
  vase: {}
moving:
  cat: {class: pet, size: [0.2, 0.1, 0.1], t: [0, 2], position: [[1, 0, 0.1], [1, 1, 0.1]], yaw: [0, 1.5], growth: 0.1}
  ball: {class: robust, size: [0.1, 0.1], t: [1], position: [[1, 0, 0.1]], spread: 0.2, severity: {carried: 0.5}}
keyframes:
  a: [0, 0, 0, -2, 0, 2, 0]
  b: [0.5, 0, 0, -2, 0, 2, 0]
tasks:
  serve: {start: a, goal: b, object: tea, support: {start: shelf, goal: floor}, description: Serve.}
  wander: {start: [0, 0, 0, -1, 0, 1, 0], goal: [a, [0.1, 0, 0, -2, 0, 2, 0]]}
  turn: {start: a, goal: [1, 0, 0, -2, 0, 2, 0]}
allowed_contacts:
  - {first: vase, second: panda/link7}
"""


def _write(folder: Path, scene: str = _SCENE, world: str = _WORLD) -> Path:
    (folder / "world.xml").write_text(world)
    file = folder / "shelf.yaml"
    file.write_text(scene)
    return file


@pytest.fixture
def shelf(tmp_path: Path) -> Scene:
    return read_scene(_write(tmp_path))


def test_everything_in_a_file_arrives(shelf: Scene) -> None:
    assert shelf.name == "shelf"
    assert shelf.notes.description == "A cup of tea on a shelf."
    assert (shelf.robot, shelf.tool) == ("panda/", "panda/tool")
    assert {e.name: e.category for e in shelf.entities.values()} == {
        "shelf": "table",
        "vase": "heirloom",
        "cup": "glass",
    }
    assert shelf.allowed_contacts == (AllowedContact("vase", "panda/link7", "always"),)
    assert list(shelf.keyframes) == ["a", "b"]
    assert shelf.home_qpos[-2:].tolist() == [0.04, 0.04]
    base = shelf.data_at(shelf.keyframes["a"]).body("panda/link0")
    np.testing.assert_allclose(base.xpos, [0, 0, 0.1])
    np.testing.assert_allclose(base.xmat.reshape(3, 3), np.diag([-1, -1, 1]), atol=1e-12)


def test_limits_and_a_tool_by_its_body(tmp_path: Path) -> None:
    text = _SCENE.replace("  quaternion: [0, 0, 0, 1]", "  limits: {panda/joint1: [-1, 1.5]}\ntool: panda/hand")
    scene = read_scene(_write(tmp_path, text))
    assert tuple(scene.limits.position[0]) == (-1.0, 1.5) and scene.tool == "panda/hand"
    np.testing.assert_allclose(scene.tasks["serve"].scene.limits.position, scene.limits.position)
    with pytest.raises(SceneError, match=r"shelf\.yaml:4: .*panda/joint1"):
        read_scene(_write(tmp_path, text.replace("[-1, 1.5]", "[2, 1]")))


def test_moving_entities_in_files(shelf: Scene) -> None:
    cat, ball = shelf.moving["cat"], shelf.moving["ball"]
    assert (cat.category, cat.is_round, cat.growth, ball.is_round, ball.spread) == ("pet", False, 0.1, True, 0.2)
    np.testing.assert_allclose(cat.at(1.0).position, [1.0, 0.5, 0.1])
    np.testing.assert_allclose(cat.at(1.0).yaw, 0.75)
    held = shelf.attach("vase", X_TO=FROM_ABOVE)
    assert held.moving_severity["ball"]["carried"] == 0.5
    assert held.moving_severity["cat"]["body"] == 30.0


def test_tasks(shelf: Scene) -> None:
    serve = shelf.tasks["serve"]
    assert serve.description == "Serve."
    np.testing.assert_array_equal(serve.start, shelf.keyframes["a"])
    np.testing.assert_array_equal(serve.goal, shelf.keyframes["b"][None])
    assert shelf.tasks["wander"].goal.shape == (2, 7)
    assert shelf.tasks["turn"].goal.tolist() == [[1, 0, 0, -2, 0, 2, 0]]
    assert shelf.tasks["turn"].scene is shelf
    holding = serve.scene
    assert holding is serve.scene
    assert holding.carried is not None and holding.carried.body == "cup"
    np.testing.assert_allclose(
        holding.carried.X_TO, [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.02], [0, 0, 0, 1]], atol=1e-12
    )
    assert holding.contents == Liquid(0.2, temperature=85.0, geoms=("tea",))
    assert holding.components["contents"].component_class == "hot"
    assert holding.entities["vase"].severity["carried"] == 33.0
    assert holding.entities["vase"].severity["contents"] == 5.0
    assert holding.entities["shelf"].severity["carried"] == 1.5
    assert "cup" not in holding.entities
    assert holding.home_qpos[-2:].tolist() == [0.03, 0.03]
    assert [(c.first, c.second) for c in holding.allowed_contacts if c.when == "ends"] == [
        ("cup", "shelf"),
        ("cup", "floor"),
    ]


def test_objects_can_be_attached_by_name(shelf: Scene) -> None:
    assert shelf.attach("tea", X_TO=FROM_ABOVE).contents == Liquid(0.2, temperature=85.0, geoms=("tea",))
    assert shelf.attach("cup", X_TO=FROM_ABOVE).contents is None
    assert (
        shelf.attach("tea", X_TO=FROM_ABOVE, contents=Granular(0.1, geoms=("tea",)))
        .components["contents"]
        .component_class
        == "dry"
    )
    heavy = shelf.attach("vase", X_TO=FROM_ABOVE)
    assert heavy.carried is not None and heavy.carried.object_class == "heavy"


def test_a_robot_may_stand_in_the_world_already(tmp_path: Path) -> None:
    joint = '<joint name="arm/j" range="-1 1" limited="true"/>'
    arm = f'<body name="arm/base">{joint}<geom size="0.1"/><site name="arm/tip"/></body>'
    world = _WORLD.replace("</worldbody>", arm + "</worldbody>")
    robot = "{prefix: arm/, velocity: [1], acceleration: [2], torque: [3]}"
    text = f"version: 1\nworld: world.xml\nrobot: {robot}\ntool: arm/tip\n"
    scene = read_scene(_write(tmp_path, text, world))
    assert scene.joints == ("arm/j",)
    assert [scene.limits.velocity[0], scene.limits.acceleration[0], scene.limits.torque[0]] == [1, 2, 3]


def test_a_custom_robot(tmp_path: Path) -> None:
    (tmp_path / "crane.xml").write_text(
        '<mujoco model="crane"><worldbody><body name="base"><joint name="j"/><geom size="0.1"/><site name="tool"/>'
        '</body></worldbody><custom><numeric name="velocity_limit" data="1"/>'
        '<numeric name="acceleration_limit" data="2"/></custom></mujoco>'
    )
    text = "version: 1\nworld: world.xml\nrobot: {model: crane.xml}\n"
    scene = read_scene(_write(tmp_path, text))
    assert scene.joints == ("crane/j",)
    renamed = read_scene(_write(tmp_path, text.replace("crane.xml", "crane.xml, prefix: c_")))
    assert (renamed.joints, renamed.limits.velocity.tolist()) == (("c_j",), [1.0])


_BROKEN = {  # text to replace, its replacement, place and words of the error
    "version": ("version: 1", "version: 2", "only version 1 of scene files is known"),
    "unknown key": ("fingers: 0.04", "finger: 0.04", "unknown key 'finger'.*valid: version, name, .*fingers"),
    "unknown key deep down": ("class: heirloom,", "klass: heirloom,", "unknown key 'klass'.*valid: class, severity"),
    "no world": ("world: world.xml", "world: ~", "needs the key 'world'"),
    "no such world": ("world: world.xml", "world: word.xml", "there is no file 'word.xml'"),
    "absolute world": ("world: world.xml", "world: /etc/passwd", "'/etc/passwd' is outside of the folder"),
    "world above": ("world: world.xml", "world: ../world.xml", "is outside of the folder"),
    "binary world": ("world: world.xml", "world: world.mjb", "neither a MJCF file"),
    "no such robot": ("model: panda", "model: pandas", "neither a MJCF file .* nor a bundled robot: .*panda"),
    "robot above": ("model: panda", "model: ../arm.xml", "is outside of the folder"),
    "base is nan": ("position: [0, 0, 0.1]", "position: [0, .nan, 0.1]", "is not finite"),
    "base in a plane": ("position: [0, 0, 0.1]", "position: [0, 0]", "has 2 numbers, expected 3"),
    "no rotation": ("quaternion: [0, 0, 0, 1]", "quaternion: [0, 0, 0, 0]", r"has length 0, expected 1 \(wxyz\)"),
    "fingers too wide": ("fingers: 0.04", "fingers: 0.05", "position of panda/finger_joint2 = 0.05"),
    "entity without body": ("  shelf: table", "  shell: table", r"unknown entity \(body\) 'shell'; valid: cup, "),
    "unknown class": ("  shelf: table", "  shelf: tabel", "unknown entity class 'tabel'; valid: adult, .*table"),
    "class is a number": ("  shelf: table", "  shelf: 3", "has to be text"),
    "negative severity": ("carried: 33", "carried: -33", "severity of vase hit by carried = -33.0"),
    "severity of nothing": (
        "carried: 33",
        "lid: 33",
        "unknown component or component class 'lid'; valid: arm_braked, ",
    ),
    "severity of unknown class": ("table: {medium", "tabel: {medium", "unknown entity or entity class 'tabel'"),
    "severity of unknown component": ("{medium: 1.5}", "{middling: 1.5}", "unknown component class 'middling'"),
    "infinite severity": ("{medium: 1.5}", "{medium: .inf}", "is not finite"),
    "object too wide": (
        "panda/finger_joint2: 0.03",
        "panda/finger_joint2: 0.3",
        "position of panda/finger_joint2 = 0.3",
    ),
    "object of no fingers": (
        "{panda/finger_joint1: 0.03",
        "{panda/joint1: 0.03",
        "unknown finger joint 'panda/joint1'",
    ),
    "no such tool": ("fingers: 0.04", "tool: panda/tap", "unknown tool .site or body. .panda/tap.; valid: "),
    "base that coasts": ("  model: panda", "  model: panda\n  body_class: fall", "class of component 'body' 'fall'"),
    "too few limits": ("  model: panda", "  model: panda\n  velocity: [1]", r"velocity limits = \[1.0\]"),
    "object without body": ("    body: cup", "    body: cop", "unknown body 'cop'"),
    "object of unknown class": ("    class: medium", "    class: middling", "class of component 'carried' 'middling'"),
    "no such contents": (
        "geoms: [tea]",
        "geoms: [milk]",
        "unknown geom for the contents of 'cup' 'milk'; valid: .*tea",
    ),
    "boiling": ("temperature: 85", "temperature: 8500", "temperature = 8500.0"),
    "strange liquid": ("kind: water", "kind: acid", "kind 'acid', expected water, oil or dry"),
    "dry and hot": ("kind: water", "kind: dry", "dry contents have no temperature"),
    "empty": ("volume: 0.2", "volume: 0", "volume = 0.0"),
    "short keyframe": ("  a: [0, 0, 0, -2, 0, 2, 0]", "  a: [0, 0]", r"keyframe 'a' has shape \(2,\)"),
    "keyframe outside": ("  a: [0, 0,", "  a: [9, 0,", "joint 0 of keyframe 'a' = 9.0, expected between -2.8973"),
    "task without keyframe": ("start: a, goal: b,", "start: c, goal: b,", "unknown keyframe 'c'; valid: a, b"),
    "task without goal": ("goal: b, object", "goal: [], object", "needs at least one goal"),
    "task without object": ("object: tea,", "object: coffee,", "unknown object 'coffee'; valid: tea, vase"),
    "task without support": ("start: shelf,", "start: shell,", "unknown body or geom 'shell'"),
    "support for nothing": ("object: tea, ", "", "a task without an object has no support"),
    "goal outside": ("goal: [1, 0, 0, -2,", "goal: [1, 9, 0, -2,", "joint 1 of configuration = 9.0"),
    "contact of nothing": ("{first: vase,", "{first: vose,", "unknown body or geom 'vose'"),
    "contact at times": ("second: panda/link7}", "second: panda/link7, when: often}", "when is 'often'"),
    "moving back in time": ("t: [0, 2]", "t: [2, 0]", r"moving.cat: t\[1\] of cat = 0.0, expected more than"),
    "moving nowhere": ("position: [[1, 0, 0.1], [1, 1, 0.1]]", "position: []", r"position of cat has shape \(0, 3\)"),
    "moving ghost": ("class: pet", "class: ghost", "unknown entity class 'ghost'"),
    "moving shelf": ("  cat: {class: pet", "  shelf: {class: pet", "name of the moving entity 'shelf' is taken"),
    "alias": ("  shelf: table", "  shelf: &a table", "anchors and aliases"),
}


@pytest.mark.parametrize("case", _BROKEN)
def test_broken_files_end_in_a_scene_error_with_a_line(case: str, tmp_path: Path) -> None:
    old, new, words = _BROKEN[case]
    assert _SCENE.count(old) == 1
    file = _write(tmp_path, _SCENE.replace(old, new))
    with pytest.raises(SceneError, match=words) as caught:
        read_scene(file)
    assert caught.value.file == str(file)
    wrong = 1 + _SCENE[: _SCENE.index(old)].count("\n")
    # The line itself, or the head of its block; the file's, if a key is missing.
    block = max(n for n, line in enumerate(_SCENE.splitlines(), start=1) if n <= wrong and line[:1] not in " #")
    assert caught.value.line in ({1} if "needs the key 'world'" in words else set(range(block, wrong + 1)))


def test_broken_worlds_are_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="broken XML") as caught:
        read_scene(_write(tmp_path, world="<mujoco>\n<worldbody>\n</mujoco>"))
    assert (caught.value.file, caught.value.line) == (str(tmp_path / "world.xml"), 3)
    with pytest.raises(SceneError, match="repeated name 'vase'"):
        read_scene(_write(tmp_path, world=_WORLD.replace('name="cup" pos', 'name="vase" pos')))
    hills = '<asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/></asset>'
    ground = '<geom name="hills" type="hfield" hfield="h"/>'
    world = _WORLD.replace("<worldbody>", hills + "<worldbody>" + ground)
    with pytest.raises(UnsupportedError, match=r"shelf\.yaml:3: .*'hills'"):
        read_scene(_write(tmp_path, world=world))


def test_later_mistakes_are_not_blamed_on_the_file(shelf: Scene) -> None:
    with pytest.raises(UnknownNameError, match="'moon'"):
        shelf.attach("tea", X_TO=FROM_ABOVE, support=["moon"])
    with pytest.raises(UnknownNameError, match="'moon'"):
        shelf.with_severity({"moon": 1.0})


_VALUES = [
    "",
    "~",
    ".nan",
    "-1",
    "1e999",
    "[]",
    "{}",
    "[1, 2",
    "&a",
    "*a",
    "!!set",
    "../x",
    "\t",
    "- ",
    ": ",
    "true",
    "999999999999",
]


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(st.integers(0, len(_SCENE)), st.integers(0, 8), st.sampled_from(_VALUES)), min_size=1, max_size=2
    )
)
def test_damaged_files_load_or_are_refused(tmp_path: Path, cuts: list[tuple[int, int, str]]) -> None:
    text = _SCENE
    for start, length, value in cuts:
        text = text[:start] + value + text[start + length :]
    try:
        scene = read_scene(_write(tmp_path, text))
    except GracefulPlanError as error:
        assert isinstance(error, SceneError)
        assert error.file is not None
    else:
        assert np.isfinite(scene.home_qpos).all()


def test_a_name_that_no_file_has_is_refused(tmp_path):
    with pytest.raises(SceneError):
        read_scene(_write(tmp_path, _SCENE.replace("world: world.xml", 'world: "a\\0.xml"')))


def test_a_task_without_a_grasp_holds_the_object_where_it_is_at_the_start(tmp_path: Path) -> None:
    grasp = next(line for line in _SCENE.splitlines(keepends=True) if "grasp:" in line)
    scene = read_scene(_write(tmp_path, _SCENE.replace(grasp, "")))
    task = next(task for task in scene.tasks.values() if task.object_name is not None)
    body = scene.notes.objects[task.object_name].body
    assert scene.notes.objects[task.object_name].X_TO is None
    before, held = scene.data_at(task.start), task.scene.data_at(task.start)
    np.testing.assert_allclose(held.body(body).xpos, before.body(body).xpos, atol=1e-12)

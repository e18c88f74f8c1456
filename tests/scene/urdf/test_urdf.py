"""Robots from URDF: limits, meshes, frames, grippers, allowed contacts, and planned motions."""

from __future__ import annotations

import importlib
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError, UnsupportedError
from graceful_plan.scene.urdf.meshes import found_mesh, mesh_content
from graceful_plan.scene.urdf.reading import read_urdf
from graceful_plan.scene.urdf.srdf import read_srdf

ARM = """<robot name="arm">
  <link name="foot"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
  <link name="trunk">
    <inertial><mass value="2"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.05" length="0.3"/></geometry></collision>
    <visual><geometry><mesh filename="package://nowhere/shiny.dae"/></geometry></visual>
  </link>
  <link name="boom">
    <inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.25 0 0"/><geometry><box size="0.4 0.06 0.06"/></geometry></collision>
  </link>
  <link name="flange"/>
  <link name="tip"/>
  <link name="left"><collision><geometry><box size="0.04 0.01 0.02"/></geometry></collision></link>
  <link name="right"><collision><geometry><box size="0.04 0.01 0.02"/></geometry></collision></link>
  <joint name="turn" type="continuous">
    <parent link="foot"/><child link="trunk"/><origin xyz="0 0 0.05"/><axis xyz="0 0 1"/>
    <limit effort="40" velocity="1.5"/>
  </joint>
  <joint name="lift" type="revolute">
    <parent link="trunk"/><child link="boom"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-1.2" upper="0.8" effort="30" velocity="1.25"/>
  </joint>
  <joint name="reach" type="prismatic">
    <parent link="boom"/><child link="flange"/><origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.2" effort="20" velocity="0.3"/>
  </joint>
  <joint name="to_tip" type="fixed"><parent link="flange"/><child link="tip"/><origin xyz="0.1 0 0"/></joint>
  <joint name="grip" type="prismatic">
    <parent link="flange"/><child link="left"/><origin xyz="0.08 0.02 0"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="0.1"/>
  </joint>
  <joint name="grip_too" type="prismatic">
    <parent link="flange"/><child link="right"/><origin xyz="0.08 -0.02 0"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="0.1"/><mimic joint="grip" multiplier="0.5" offset="0.001"/>
  </joint>
</robot>"""
SRDF = """<robot name="arm">
  <disable_collisions link1="foot" link2="boom" reason="Never"/>
  <disable_collisions link1="foot" link2="unheard" reason="Never"/>
  <group_state name="home" group="arm"><joint name="turn" value="0.5"/><joint name="lift" value="-0.5"/>
    <joint name="reach" value="0.1"/></group_state>
  <group_state name="open" group="hand"><joint name="grip" value="0.04"/></group_state>
</robot>"""
CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * 0.05
FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]  # fmt: skip


@pytest.fixture(scope="module")
def arm() -> gp.Scene:
    return gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, srdf=SRDF, fingers=0.02)


def _binary(triangles: np.ndarray) -> bytes:
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in triangles)
    return b"solid but binary".ljust(80) + struct.pack("<I", len(triangles)) + records


def _words(triangles: np.ndarray) -> bytes:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) + "endloop\nendfacet\n"
        for t in triangles.tolist()
    )
    return f"solid cube\n{facets}endsolid".encode()


def test_limits_and_names_are_those_of_the_urdf(arm: gp.Scene) -> None:
    assert arm.joints == ("arm/turn", "arm/lift", "arm/reach")
    np.testing.assert_array_equal(arm.limits.velocity, [1.5, 1.25, 0.3])
    np.testing.assert_array_equal(arm.limits.torque, [40.0, 30.0, 20.0])
    np.testing.assert_array_equal(arm.limits.acceleration, [4.0] * 3)
    np.testing.assert_allclose(arm.limits.position[1:], [[-1.2, 0.8], [0.0, 0.2]])
    chosen = gp.Scene.from_urdf(ARM, tool="tip", acceleration=[1.0, 2.0, 3.0], velocity=[1.0, 1.0, 1.0])
    np.testing.assert_array_equal(chosen.limits.acceleration, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(chosen.limits.velocity, [1.0] * 3)


def test_the_tool_is_where_the_chain_puts_it(arm: gp.Scene) -> None:
    turn, lift, reach = q = np.array([0.7, -0.4, 0.15])
    out = (0.6 + reach) * np.cos(lift)
    expected = [out * np.cos(turn), out * np.sin(turn), 0.45 - (0.6 + reach) * np.sin(lift)]
    np.testing.assert_allclose(gp.StateBatch(arm, q[None]).tool_poses[0, :3, 3], expected, atol=1e-9)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [1.0, 2.0, 3.0]
    moved = gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, pose=X)
    at = gp.StateBatch(moved, q[None]).tool_poses[0, :3, 3]
    np.testing.assert_allclose(at, X[:3, :3] @ expected + X[:3, 3], atol=1e-9)


def test_fingers_that_mimic_follow(arm: gp.Scene) -> None:
    at = {name: arm.home_qpos[arm.model.joint(f"arm/{name}").qposadr[0]] for name in ("grip", "grip_too")}
    assert at == {"grip": pytest.approx(0.02), "grip_too": pytest.approx(0.011)}
    by_name = gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, fingers={"arm/grip": 0.03})
    assert by_name.home_qpos[by_name.model.joint("arm/grip").qposadr[0]] == pytest.approx(0.03)


def test_allowed_contacts(arm: gp.Scene) -> None:
    pairs = {frozenset((c.first, c.second)) for c in arm.allowed_contacts}
    neighbours = {("foot", "trunk"), ("trunk", "boom"), ("boom", "flange"), ("flange", "left"), ("flange", "right")}
    for a, b in neighbours - {("foot", "trunk")}:
        assert frozenset((f"arm/{a}", f"arm/{b}")) in pairs
    assert frozenset(("arm/foot", "arm/boom")) in pairs  # by the SRDF
    assert not any("unheard" in name for pair in pairs for name in pair)
    assert gp.clearance([0.0, 0.0, 0.0], arm) > 0.0  # though the trunk stands in the foot


def test_group_states_are_keyframes(arm: gp.Scene) -> None:
    np.testing.assert_array_equal(arm.keyframes["home"], [0.5, -0.5, 0.1])
    assert "open" not in arm.keyframes


@pytest.mark.parametrize(("start", "goal", "way"), [(3.0, -3.0, 0.283), (-3.0, 3.0, 0.283), (6.0, 0.3, 0.583)])
def test_joints_without_limits_take_the_short_way_round(arm: gp.Scene, start: float, goal: float, way: float) -> None:
    assert arm.endless.tolist() == [True, False, False]
    wanted = np.array([goal, 0.0, 0.1])
    result = gp.plan([start, 0.0, 0.1], wanted, arm, w=0.0, iterations=100)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert result.trajectory.path.length == pytest.approx(way, abs=0.01)
    assert gp.verify(result.trajectory, arm, goal=wanted).checks["goal"].passed
    assert not gp.verify(result.trajectory, arm, goal=wanted + [0.0, 0.0, 0.05]).checks["goal"].passed


def test_motions_are_planned_among_obstacles() -> None:
    post = '<body name="post" pos="0.6 0 0.4"><geom type="box" size="0.05 0.05 0.4"/></body>'
    world = f"<mujoco><worldbody>{post}</worldbody></mujoco>"
    scene = gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, world=world, entities={"post": "glass"})
    result = gp.plan([-0.8, 0.1, 0.0], [0.8, 0.1, 0.0], scene, w=0.0, iterations=2000)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert result.trajectory.path.length > 1.605  # over the post, not through it
    assert list(scene.entities) == ["post"]


@pytest.mark.parametrize("written", [_binary, _words])
def test_meshes_are_found_in_packages(tmp_path: Path, written) -> None:
    folder = tmp_path / "ws" / "cube_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "urdf").mkdir()
    (folder / "meshes" / "Cube 1.STL").write_bytes(written(CUBE[FACES]))
    mesh = '<mesh filename="package://cube_description/meshes/Cube%201.STL" scale="1 2 1"/>'
    text = ARM.replace('<box size="0.4 0.06 0.06"/>', mesh)
    file = folder / "urdf" / "arm.urdf"
    file.write_text(text)
    scene = gp.Scene.from_urdf(file, tool="tip", acceleration=4.0)
    geom = next(g for g in range(scene.model.ngeom) if scene.model.geom_dataid[g] >= 0)
    np.testing.assert_allclose(np.sort(scene.model.geom_aabb[geom, 3:]), [0.05, 0.05, 0.1], atol=1e-6)
    for packages in ([tmp_path / "ws"], [folder], {"cube_description": folder}):
        gp.Scene.from_urdf(text, tool="tip", acceleration=4.0, packages=packages)
    with pytest.raises(SceneError, match="packages="):
        gp.Scene.from_urdf(text, tool="tip", acceleration=4.0)


def test_packages_may_have_other_names_than_their_folders(tmp_path: Path) -> None:
    (tmp_path / "of_another_name").mkdir()
    file = tmp_path / "of_another_name" / "cube.stl"
    file.write_bytes(_binary(CUBE[FACES]))
    assert found_mesh("package://pack/cube.stl", None, {"pack": tmp_path / "of_another_name"}) == file
    for named in ({"pack": tmp_path}, {"other": tmp_path / "of_another_name"}, {}):
        with pytest.raises(SceneError, match="its folder"):
            found_mesh("package://pack/cube.stl", None, named)


def test_meshes_outside_of_the_folder_are_read_only_if_allowed(tmp_path: Path) -> None:
    package = tmp_path / "package"
    (package / "urdf").mkdir(parents=True)
    (package / "urdf" / "inside.stl").write_bytes(_binary(CUBE[FACES]))
    (package / "beside.stl").write_bytes(_binary(CUBE[FACES]))
    (tmp_path / "outside.stl").write_bytes(_binary(CUBE[FACES]))
    (package / "urdf" / "link.stl").symlink_to(tmp_path / "outside.stl")
    file = package / "urdf" / "arm.urdf"

    def read(mesh: str, *packages: Path) -> gp.Scene:
        file.write_text(ARM.replace('<box size="0.4 0.06 0.06"/>', f'<mesh filename="{mesh}"/>'))
        return gp.Scene.from_urdf(file, tool="tip", acceleration=4.0, packages=packages)

    read("inside.stl")
    read(f"file://{package}/urdf/inside.stl")
    outside = "../../outside.stl", f"{tmp_path}/outside.stl", f"file://{tmp_path}/outside.stl", "link.stl"
    for mesh in (*outside, "../beside.stl"):
        with pytest.raises(SceneError, match=r"arm\.urdf: .*outside of the folder.*packages=\[FOLDER\]"):
            read(mesh)
    read("../beside.stl", package)
    (package / "package.xml").write_text("<package/>")
    read("../beside.stl")
    for mesh in outside:
        with pytest.raises(SceneError, match="outside of the folder"):
            read(mesh)
        read(mesh, tmp_path)
    for mesh in ("http://host/outside.stl", "file://outside.stl"):
        with pytest.raises(SceneError, match=r"file"):
            read(mesh, tmp_path)


def test_meshes_of_a_text_come_from_packages_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cube.stl").write_bytes(_binary(CUBE[FACES]))
    monkeypatch.chdir(tmp_path)
    for mesh in ("cube.stl", str(tmp_path / "cube.stl")):
        text = ARM.replace('<box size="0.4 0.06 0.06"/>', f'<mesh filename="{mesh}"/>')
        with pytest.raises(SceneError, match=r"outside|packages="):
            gp.Scene.from_urdf(text, tool="tip", acceleration=4.0)
        gp.Scene.from_urdf(text, tool="tip", acceleration=4.0, packages=[tmp_path])


def test_errors_of_meshes_name_them(tmp_path: Path) -> None:
    (tmp_path / "odd part.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    text = ARM.replace('<box size="0.4 0.06 0.06"/>', '<mesh filename="odd%20part.obj"/>')
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(SceneError, match=r"arm\.urdf: .*odd.*part"):
        gp.Scene.from_urdf(tmp_path / "arm.urdf", tool="tip", acceleration=4.0)


def test_limits_beyond_all_places_are_refused() -> None:
    text = ARM.replace('lower="0" upper="0.2"', 'lower="-1e308" upper="1e308"')
    with pytest.raises(SceneError, match=r"'arm/reach'.*1e\+308"):
        gp.Scene.from_urdf(text, tool="tip", acceleration=4.0)


def test_attributes_of_other_programs_are_left_out() -> None:
    text = ARM.replace("<limit ", '<limit drake:acceleration="2.5" ').replace("<robot ", '<robot foo:bar="1" ', 1)
    assert "drake:" in text
    mine, plain = (gp.Scene.from_urdf(t, tool="tip", acceleration=4.0) for t in (text, ARM))
    np.testing.assert_array_equal(mine.limits.position, plain.limits.position)


def test_packages_are_not_left(tmp_path: Path) -> None:
    (tmp_path / "pack").mkdir()
    (tmp_path / "secret.stl").write_bytes(_binary(CUBE[FACES]))
    with pytest.raises(SceneError, match="was not found"):
        found_mesh("package://pack/../secret.stl", None, [tmp_path])
    with pytest.raises(SceneError, match="was not found"):
        found_mesh("package://pack/../secret.stl", None, {"pack": tmp_path / "pack"})


def test_collada_needs_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with suppress(ImportError):  # trimesh looks for the library only on its first import
        importlib.import_module("trimesh.exchange.load")
    file = tmp_path / "a.dae"
    file.write_text("<COLLADA/>")
    monkeypatch.setitem(__import__("sys").modules, "collada", None)
    with pytest.raises(UnsupportedError, match=r"\.\[urdf\]"):
        mesh_content(file)
    with pytest.raises(UnsupportedError, match=r"\.stl, \.obj.*\.dae"):
        (tmp_path / "a.fbx").write_text("")
        mesh_content(tmp_path / "a.fbx")
    (tmp_path / "b.stl").write_text("solid b\nfacet normal 0 0 1\nouter loop\nvertex 0 0 x\n")
    with pytest.raises(SceneError, match="STL"):
        mesh_content(tmp_path / "b.stl")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<robot", "not XML"),
        ("<mujoco/>", "root <robot>"),
        ('<!DOCTYPE robot [<!ENTITY a "b">]><robot/>', "document types"),
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro/></robot>', "xacro"),
        ("<robot><link name='a'/></robot>", "no link has collision geometry"),
        (ARM.replace('<parent link="foot"/>', ""), "parent"),
        (ARM.replace('velocity="1.5"', 'velocity="fast"'), "not a number"),
        (ARM.replace('velocity="1.5"', ""), "velocity="),
        (ARM.replace('<joint name="turn"', '<link name="other"/><joint name="turn"'), "one root link"),
        (ARM.replace('ixx="0.01"', 'ixx="nan"'), "not finite"),
    ],
)
def test_errors_of_broken_files_name_the_problem(text: str, told: str) -> None:
    with pytest.raises(SceneError, match=told):
        gp.Scene.from_urdf(text, tool="tip", acceleration=4.0)


def test_tools_that_are_none() -> None:
    with pytest.raises(UnknownNameError, match="nose"):
        gp.Scene.from_urdf(ARM, tool="nose", acceleration=4.0)
    with pytest.raises(UnsupportedError, match="grip_too"):
        gp.Scene.from_urdf(ARM, tool="right", acceleration=4.0)
    with pytest.raises(SceneError, match="cannot be read"):
        read_urdf(Path("nowhere.urdf"))
    with pytest.raises(SceneError, match="home"):
        read_srdf(SRDF.replace('value="0.5"', 'value="high"'))


# --- what is planned, and the state of the rest -----------------------------------------------------------------------

GROUPS = """<robot name="arm">
  <group name="arm"><chain base_link="foot" tip_link="tip"/></group>
  <group name="crane"><group name="arm"/></group>
  <group name="boom"><joint name="lift"/><link name="flange"/></group>
  <group name="hand"><joint name="grip_too"/></group>
  <group name="ring"><group name="ring"/></group>
  <group_state name="rounded" group="arm"><joint name="turn" value="9"/><joint name="lift" value="{lift}"/>
    <joint name="reach" value="0.1"/></group_state>
  <group_state name="open" group="hand"><joint name="grip" value="0.04"/><joint name="turn" value="0.5"/></group_state>
</robot>"""


@pytest.mark.parametrize(
    ("group", "expected"),
    [("arm", ["turn", "lift", "reach"]), ("crane", ["turn", "lift", "reach"]), ("boom", ["lift", "reach"])],
)
def test_a_group_of_the_srdf_says_what_is_planned(group: str, expected: list[str]) -> None:
    text = GROUPS.format(lift=0.0)
    scene = gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, srdf=text, group=group, state="open")
    assert scene.joints == tuple(f"arm/{name}" for name in expected)
    named = gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, srdf=text, joints=scene.joints, state="open")
    assert named.joints == scene.joints
    np.testing.assert_array_equal(named.limits.velocity, scene.limits.velocity)
    state = {
        name: scene.home_qpos[scene.model.joint(f"arm/{name}").qposadr[0]] for name in ("grip", "grip_too", "turn")
    }
    assert state == pytest.approx({"grip": 0.04, "grip_too": 0.021, "turn": 0.5 if group == "boom" else 0.0})


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"group": "leg"}, UnknownNameError, "'leg'; valid: arm, boom"),
        ({"group": "hand"}, SceneError, "no joints that can be planned"),
        ({"group": "ring"}, SceneError, "no joints that can be planned"),
        ({"group": "arm", "joints": ["turn"]}, SettingError, "group"),
        ({"joints": ["grip_too"]}, UnknownNameError, "joint to plan 'grip_too'; valid: grip, lift"),
        ({"joints": ["lift", "turn"]}, SettingError, "order of the model"),
        ({"joints": ["grip"]}, SettingError, "moves the tool"),
        ({"state": "shut"}, UnknownNameError, "'shut'; valid: open, rounded"),
    ],
)
def test_impossible_choices(given: dict[str, object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, srdf=GROUPS.format(lift=0.0), **given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("lift", "kept"), [(0.8 + 1e-5, 0.8), (0.817, 0.8), (-1.2 - 1e-5, -1.2), (0.5, 0.5), (0.9, None)]
)
def test_states_outside_of_limits_do_not_keep_a_robot_from_loading(
    lift: float, kept: float | None, caplog: pytest.LogCaptureFixture
) -> None:
    scene = gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, srdf=GROUPS.format(lift=lift))
    told = [record.getMessage() for record in caplog.records if "rounded" in record.getMessage()]
    assert len(told) == (kept != lift) and all("lift" in text for text in told)
    if kept is None:
        assert "rounded" not in scene.keyframes and "left out" in told[0]
        return
    np.testing.assert_allclose(scene.keyframes["rounded"], [9.0 - 2.0 * np.pi, kept, 0.1])
    wider = {"limits": {"arm/lift": (-2.0, 2.0)}}
    wide = gp.Scene.from_urdf(ARM, tool="tip", acceleration=4.0, srdf=GROUPS.format(lift=lift), **wider)  # type: ignore[arg-type]
    np.testing.assert_allclose(wide.keyframes["rounded"][1], lift)


def test_a_mimic_joint_of_a_planned_joint_is_refused() -> None:
    text = ARM.replace('mimic joint="grip"', 'mimic joint="reach"')
    with pytest.raises(UnsupportedError, match=r"joint equality .*of arm/grip_too and arm/reach"):
        gp.Scene.from_urdf(text, tool="tip", acceleration=4.0)


def test_limits_that_contradict_each_other_are_refused_and_missing_ones_named(caplog: pytest.LogCaptureFixture) -> None:
    def arm(limit: str) -> str:
        geometry = '<collision><geometry><box size=".1 .1 .1"/></geometry></collision>'
        mass = '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
        links = "".join(f'<link name="{name}">{mass}{geometry}</link>' for name in ("base", "tip"))
        joint = f'<parent link="base"/><child link="tip"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/>{limit}'
        return f'<robot name="arm">{links}<joint name="turn" type="revolute">{joint}</joint></robot>'

    with pytest.raises(SceneError, match=r"'turn'.*2.*1"):
        read_urdf(arm('<limit lower="2" upper="1" effort="1" velocity="1"/>'))
    with caplog.at_level("WARNING"):
        read_urdf(arm(""))
    assert "'turn'" in caplog.text

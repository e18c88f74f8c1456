"""Problem files: three formats with the same problems; broken files are refused with file and key."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from places import ROOT

import graceful_plan as gp
from graceful_plan.compare.problems.motion_problem import Obstacle, ProblemFile
from graceful_plan.compare.problems.problem_files import load_problems
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import FormatError, SceneError, SettingError, UnknownNameError
from graceful_plan.scene.pose_goal import pose_error

Array = np.ndarray

_READY = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
_OTHER = [0.6, -0.5, 0.2, -2.0, 0.1, 1.7, 0.4]
_TURN = [0.8, 0.0, 0.0, 0.6]
"""Quaternion, wxyz."""
_JOINTS = [f"panda_joint{k}" for k in range(1, 8)]


def _robometrics() -> dict[str, Any]:
    obstacles = {
        "cuboid": {"shelf": {"dims": [0.2, 1.0, 0.04], "pose": [0.7, 0.1, 0.3, *_TURN]}},
        "cylinder": {"can": {"radius": 0.03, "height": 0.14, "pose": [0.7, 0.0, 0.4, *_TURN]}},
        "sphere": {"ball": {"radius": 0.05, "position": [0.2, 0.6, 0.8]}},
    }
    problem = {"start": [*_READY], "goal_ik": [[*_OTHER]], "obstacles": obstacles, "world_frame": "panda_link0"}
    return {"shelf": [problem]}


def _xyzw(wxyz: list[float]) -> list[float]:
    return [*wxyz[1:], wxyz[0]]


def _vamp() -> dict[str, Any]:
    place = {"orientation_quat_xyzw": _xyzw(_TURN), "orientation_euler_xyz": [0.0, 0.0, 1.287]}
    problem = {
        "index": 1,
        "start": _READY,
        "goals": [_OTHER],
        "valid": True,
        "box": [{"name": "shelf", "half_extents": [0.1, 0.5, 0.02], "position": [0.7, 0.1, 0.3], **place}],
        "cylinder": [{"name": "can", "radius": 0.03, "length": 0.14, "position": [0.7, 0.0, 0.4], **place}],
        "sphere": [{"name": "ball", "radius": 0.05, "position": [0.2, 0.6, 0.8]}],
    }
    return {"robot": "panda", "joints": _JOINTS, "problems": {"shelf": [problem]}}


def _moveit() -> tuple[dict[str, Any], dict[str, Any]]:
    def one(name: str, kind: str, dimensions: list[float], position: list[float], wxyz: list[float]) -> dict[str, Any]:
        pose = {"position": position, "orientation": _xyzw(wxyz)}
        primitive = {"type": kind, "dimensions": dimensions}
        return {
            "id": name,
            "header": {"frame_id": "base_link"},
            "primitives": [primitive],
            "primitive_poses": [pose],
        }

    objects = [
        one("shelf", "box", [0.2, 1.0, 0.04], [0.7, 0.1, 0.3], _TURN),
        one("can", "cylinder", [0.14, 0.03], [0.7, 0.0, 0.4], _TURN),
        one("ball", "sphere", [0.05], [0.2, 0.6, 0.8], [1.0, 0.0, 0.0, 0.0]),
    ]
    state = {"name": ["panda_finger_joint1", *_JOINTS[::-1]], "position": [0.04, *_READY[::-1]]}
    constraints = [{"joint_name": name, "position": q, "weight": 1} for name, q in zip(_JOINTS, _OTHER, strict=True)]
    request = {
        "group_name": "panda_arm",
        "start_state": {"joint_state": state},
        "goal_constraints": [{"joint_constraints": constraints}],
    }
    return {"name": "x", "world": {"collision_objects": objects}}, request


def _write(file: Path, document: Any) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(document) if file.suffix == ".json" else yaml.safe_dump(document))
    return file


def _written(folder: Path, form: str) -> Path:
    """Write the same problem in one of the formats."""
    if form == "robometrics":
        return _write(folder / "set.yaml", _robometrics())
    if form == "vamp":
        return _write(folder / "problems.json", _vamp())
    scene, request = _moveit()
    _write(folder / "shelf" / "scene0001.yaml", scene)
    _write(folder / "shelf" / "request0001.yaml", request)
    return folder


# --- valid files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["robometrics", "vamp", "moveit"])
def test_every_format_gives_the_same_problem(tmp_path: Path, form: str):
    (problem,) = gp.load_problems(_written(tmp_path, form))
    assert problem.group == "shelf" and problem.name in ("shelf/0", "shelf/1")
    np.testing.assert_array_equal(problem.start, _READY)
    np.testing.assert_array_equal(problem.goals, [_OTHER])
    np.testing.assert_array_equal(problem.goal, [_OTHER])
    by_name = {obstacle.name: obstacle for obstacle in problem.obstacles}
    assert {name: obstacle.kind for name, obstacle in by_name.items()} == {
        "shelf": "box",
        "can": "cylinder",
        "ball": "sphere",
    }
    assert by_name["shelf"].size == (0.1, 0.5, 0.02)
    assert by_name["can"].size == (0.03, 0.07) and by_name["ball"].size == (0.05,)
    c, s = 0.28, 0.96  # cosine and sine of the whole angle; the quaternion holds the half angle
    shelf = [[c, -s, 0, 0.7], [s, c, 0, 0.1], [0, 0, 1, 0.3], [0, 0, 0, 1]]
    np.testing.assert_allclose(by_name["shelf"].X_WO, shelf, atol=1e-12)
    np.testing.assert_allclose(by_name["ball"].X_WO[:3, 3], [0.2, 0.6, 0.8])


@pytest.mark.parametrize("form", ["robometrics", "vamp", "moveit"])
def test_scenes_have_the_obstacles_where_they_are(tmp_path: Path, form: str):
    scene = gp.load_problems(_written(tmp_path, form))[0].scene
    np.testing.assert_allclose(scene.model.geom("can").size[:2], [0.03, 0.07])
    np.testing.assert_allclose(scene.model.body("can").pos, [0.7, 0.0, 0.4])
    np.testing.assert_allclose(scene.model.body("can").quat, _TURN, atol=1e-12)
    assert scene.joints == tuple(f"panda/joint{k}" for k in range(1, 8))
    # The shelf's far corner, computed by hand, is on its surface: a probe there is in contact.
    corner = np.array([0.7, 0.1, 0.3]) + np.array([0.28 * 0.1 - 0.96 * 0.5, 0.96 * 0.1 + 0.28 * 0.5, 0.02])
    shelf = scene.model.body("shelf")
    R = np.array([[0.28, -0.96, 0.0], [0.96, 0.28, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(R.T @ (corner - shelf.pos), [0.1, 0.5, 0.02], atol=1e-12)


def test_problems_can_be_planned(tmp_path: Path):
    (problem,) = gp.load_problems(_written(tmp_path, "robometrics"))
    result = gp.plan(problem.start, problem.goal, problem.scene, w=0.0, iterations=500)
    assert result.status is gp.PlanStatus.SOLVED


def test_the_guide_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    guide = ROOT / "docs" / "problem-files.md"
    (snippet,) = re.findall(r"^```python\n(.*?)^```", guide.read_text(), flags=re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, guide.name, "exec"), {})
    assert "problems.yaml: " in capsys.readouterr().out
    _write(tmp_path / "problems.yaml", {"bookshelf_small_panda": _robometrics()["shelf"]})
    exec(compile(snippet, guide.name, "exec"), {})
    assert capsys.readouterr().out.startswith("bookshelf_small_panda/0 ")


@pytest.mark.parametrize(("frame", "turn"), [("panda_hand", 0.0), ("panda_link8", -np.pi / 4.0), (None, 0.0)])
def test_poses_of_the_hand_become_poses_of_the_tool(tmp_path: Path, frame: str | None, turn: float):
    """A pose of the hand or flange, taken from forward kinematics, becomes the tool's pose at that configuration."""
    document = _robometrics()
    problem = document["shelf"][0]
    scene = load_problems(_write(tmp_path / "a.yaml", document))[0].scene
    data = scene.data_at(_OTHER)
    hand = data.body("panda/hand")
    half = 0.5 * -turn  # the flange is turned back relative to the hand
    w, x, y, z = hand.xquat
    c, s = np.cos(half), np.sin(half)
    quaternion = [w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s]
    pose = {"frame": frame, "position_xyz": hand.xpos.tolist(), "quaternion_wxyz": [float(v) for v in quaternion]}
    problem["goal_ik"] = []
    problem["goal_pose"] = pose if frame else [*hand.xpos.tolist(), *hand.xquat.tolist()]
    found = load_problems(_write(tmp_path / "b.yaml", document))[0]
    assert len(found.goals) == 0 and isinstance(found.goal, gp.PoseGoal) and found.pose is not None
    reached = compile_scene(scene).kernels.tool_pose(np.array(_OTHER))
    assert max(pose_error(found.pose, reached)) < 1e-6


def test_an_unknown_frame_matters_only_if_the_pose_is_needed(tmp_path: Path):
    document = _robometrics()
    pose = {"frame": "right_gripper", "position_xyz": [0.5, 0, 0.5], "quaternion_wxyz": [1, 0, 0, 0]}
    document["shelf"][0]["goal_pose"] = pose
    assert load_problems(_write(tmp_path / "a.yaml", document))[0].pose is None
    del document["shelf"][0]["goal_ik"]
    with pytest.raises(FormatError, match=r"shelf\[0\]\.goal_pose\.frame.*'right_gripper'"):
        load_problems(_write(tmp_path / "b.yaml", document))


def test_groups_are_chosen_by_name(tmp_path: Path):
    document = _robometrics()
    document["box"] = document["shelf"] * 2
    file = _write(tmp_path / "a.yaml", json.loads(json.dumps(document)))
    assert [problem.name for problem in load_problems(file, groups=["box"])] == ["box/0", "box/1"]
    assert len(load_problems(file)) == 3
    with pytest.raises(UnknownNameError, match=r"'cage'.*box, shelf"):
        load_problems(file, groups=["cage"])


def test_joints_come_in_the_file_s_own_order(tmp_path: Path):
    document = _vamp()
    document["joints"] = _JOINTS[::-1]
    problem = document["problems"]["shelf"][0]
    problem["start"], problem["goals"] = _READY[::-1], [_OTHER[::-1]]
    (found,) = load_problems(_write(tmp_path / "a.json", document))
    np.testing.assert_array_equal(found.start, _READY)
    np.testing.assert_array_equal(found.goals, [_OTHER])


def test_parts_of_one_object_are_placed_in_its_pose(tmp_path: Path):
    scene, request = _moveit()
    (ball,) = [o for o in scene["world"]["collision_objects"] if o["id"] == "ball"]
    ball["pose"] = {"position": [0.0, 0.0, 0.1], "orientation": [0.0, 0.0, 1.0, 0.0]}
    ball["primitives"] *= 2
    ball["primitive_poses"] *= 2
    ball["primitives"][1] = {"type": 2, "dimensions": [0.01]}  # MoveIt's number for a sphere
    _write(tmp_path / "scene0001.yaml", json.loads(json.dumps(scene)))
    _write(tmp_path / "request0001.yaml", request)
    by_name = {obstacle.name: obstacle for obstacle in load_problems(tmp_path)[0].obstacles}
    np.testing.assert_allclose(by_name["ball_0"].X_WO[:3, 3], [-0.2, -0.6, 0.9], atol=1e-12)
    assert by_name["ball_1"].kind == "sphere" and by_name["ball_1"].size == (0.01,)


def test_fingers_have_the_requested_width(tmp_path: Path):
    file = _written(tmp_path, "robometrics")
    for opening in (0.0, 0.04):
        scene = load_problems(file, fingers=opening)[0].scene
        adr = scene.model.joint("panda/finger_joint1").qposadr[0]
        assert scene.home_qpos[adr] == opening
    with pytest.raises(SettingError, match="fingers"):
        load_problems(file, fingers=0.05)


def test_numbers_in_scientific_notation_are_numbers(tmp_path: Path):
    text = yaml.safe_dump(_robometrics()).replace("0.05", "5e-2")  # text in YAML 1.1
    (tmp_path / "a.yaml").write_text(text)
    (problem,) = load_problems(tmp_path / "a.yaml")
    assert {o.size for o in problem.obstacles if o.kind == "sphere"} == {(0.05,)}


# --- refused files ----------------------------------------------------------------------------------------------------


def _broken(change: str) -> dict[str, Any]:
    document = _robometrics()
    problem = document["shelf"][0]
    exec(change, {"p": problem, "d": document})  # the changes are in the parameters below
    return document


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("del p['start']", r"shelf\[0\] needs the key 'start'"),
        ("p['start'] = [0.0] * 6", r"shelf\[0\].start has 6 values, expected 7 numbers"),
        ("p['start'][2] = float('nan')", r"shelf\[0\].start\[2\] = nan has to be finite"),
        ("p['start'][2] = True", r"shelf\[0\].start\[2\] has to be a number, not 'True'"),
        ("p['start'] = 'ready'", r"shelf\[0\].start has to be a list of 7 numbers"),
        ("p['goal_ik'] = []", r"shelf\[0\] needs goal_ik or goal_pose"),
        ("p['goal_ik'] = [[1.0]]", r"shelf\[0\].goal_ik\[0\] has 1 values"),
        (
            "p['world_frame'] = 'camera'",
            r"shelf\[0\].world_frame = 'camera'; poses have to be in the frame of the base",
        ),
        ("p['obstacles'] = []", r"shelf\[0\].obstacles has to be a mapping"),
        ("p['obstacles']['mesh'] = {}", r"obstacles.mesh is an unknown kind of obstacle; known: cuboid"),
        ("p['obstacles']['cuboid']['shelf']['dims'][0] = 0", r"shelf.dims\[0\] = 0 has to be finite and > 0"),
        ("p['obstacles']['cuboid']['shelf']['pose'][3] = 5.0", r"shelf.pose holds a quaternion of length 5.0"),
        ("del p['obstacles']['cylinder']['can']['height']", r"cylinder.can needs the key 'height'"),
        ("p['obstacles']['sphere']['can'] = p['obstacles']['sphere']['ball']", r"two obstacles with the name 'can'"),
        ("p['obstacles']['sphere']['panda/hand'] = p['obstacles']['sphere']['ball']", r"which is the robot's"),
        ("p['obstacles']['sphere'][3] = p['obstacles']['sphere']['ball']", r"has the key 3, which is not a text"),
        ("d['shelf'] = 3", r"shelf has to be a list"),
        ("d.clear()", r"holds no problem"),
    ],
)
def test_errors_name_the_culprit(tmp_path: Path, change: str, message: str):
    file = tmp_path / "a.yaml"
    file.write_text(yaml.dump(_broken(change), Dumper=_NoAliases))
    with pytest.raises(FormatError, match=message) as caught:
        load_problems(file)
    assert str(file) in str(caught.value)


class _NoAliases(yaml.SafeDumper):
    def ignore_aliases(self, data: object) -> bool:
        del data
        return True


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1, 2", "broken YAML in line"),
        ("a: &x [1]\nb: *x", r"anchors and aliases are not read \(line 1\)"),
        ("[" * 100_000, "nested deeper than 24 levels"),
        ("a: !!python/object:os.system {}", "broken YAML"),
        ("version https://git-lfs.github.com/spec/v1\nsize: 3", "pointer of git-lfs"),
        ("", "has to be a mapping"),
        ("- 1", "has to be a mapping"),
        ("\x00", "broken YAML"),
    ],
)
def test_hostile_yaml_is_refused(tmp_path: Path, text: str, message: str):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(FormatError, match=message):
        load_problems(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"robot": "ur5"}, "only problems for 'panda' are read"),
        ({"joints": _JOINTS[:6]}, "has to name 'panda_joint7' once"),
        ({"problems": {"shelf": [{"start": _READY, "goals": []}]}}, r"goals has to hold at least one goal"),
        ({"problems": None}, "needs the key 'problems'"),
        (
            {"problems": {"shelf": [{"start": _READY, "goals": [_OTHER], "capsule": [{}]}]}},
            "capsule is an unknown kind",
        ),
    ],
)
def test_broken_problems_of_vamp_are_refused(tmp_path: Path, change: dict[str, Any], message: str):
    with pytest.raises(FormatError, match=message):
        load_problems(_write(tmp_path / "a.json", _vamp() | change))


def test_other_files_are_refused(tmp_path: Path):
    for name, message in (("a.pkl", "can run code"), ("a.txt", "has to be a .yaml or .json file")):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(FormatError, match=message):
            load_problems(tmp_path / name)
    with pytest.raises(FormatError, match="cannot be read"):
        load_problems(tmp_path / "absent.yaml")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(FormatError, match="not JSON"):
        load_problems(tmp_path / "deep.json")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="is not UTF-8"):
        load_problems(tmp_path / "bytes.yaml")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FormatError, match="holds no problem"):
        load_problems(tmp_path / "empty")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("o['meshes'] = [{'vertices': []}]", "meshes are not read; only primitives"),
        ("o['primitives'][0]['type'] = 'cone'", "'cone' is an unknown primitive"),
        ("o['primitives'].append(o['primitives'][0])", "has 2 primitives and 1 poses"),
        ("o['header']['frame_id'] = 'camera'", "poses have to be in the frame of the base"),
        ("s['world']['octomap'] = {'octomap': {'data': [1]}}", "octomap is not read"),
        ("r['start_state']['joint_state']['name'].pop()", "has 7 names and 8 positions"),
        ("r['start_state']['attached_collision_objects'] = [{}]", "only an empty gripper is"),
        ("r['goal_constraints'] = []", "has to hold at least one goal"),
        ("r['goal_constraints'] = [{'position_constraints': []}]", "needs the key 'joint_constraints'"),
    ],
)
def test_broken_pairs_of_moveit_are_refused(tmp_path: Path, change: str, message: str):
    scene, request = _moveit()
    exec(change, {"o": scene["world"]["collision_objects"][0], "s": scene, "r": request})
    (tmp_path / "scene0001.yaml").write_text(yaml.dump(scene, Dumper=_NoAliases))
    (tmp_path / "request0001.yaml").write_text(yaml.dump(request, Dumper=_NoAliases))
    with pytest.raises(FormatError, match=message):
        load_problems(tmp_path)


def test_a_request_without_its_scene_is_refused(tmp_path: Path):
    _write(tmp_path / "request0007.yaml", _moveit()[1])
    with pytest.raises(FormatError, match=r"scene0007\.yaml"):
        load_problems(tmp_path)


def test_obstacles_of_other_kinds_are_refused():
    with pytest.raises(UnknownNameError, match=r"'cone'.*box, cylinder, sphere"):
        Obstacle(name="hat", kind="cone", size=(0.1, 0.1), X_WO=np.eye(4))


def test_obstacles_without_size_are_refused_when_the_scene_is_made():
    flat = Obstacle(name="flat", kind="box", size=(0.1, 0.1, 0.0), X_WO=np.eye(4))
    problem = ProblemFile(
        name="a/0",
        group="a",
        start=np.array(_READY),
        goals=np.zeros((0, 7)),
        pose=None,
        obstacles=(flat,),
        fingers=0.0,
    )
    with pytest.raises(SceneError, match=r"a/0: size.*flat"):
        _ = problem.scene

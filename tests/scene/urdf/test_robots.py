"""Published robot models, from packages that `make test-robots` installs, can be loaded and planned for."""

from __future__ import annotations

import os
import re
import sysconfig
from pathlib import Path

import mujoco
import numpy as np
import pytest

import failbench as fb
import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SceneError
from graceful_plan.judge.exact import Judge

DATA = Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share"
MJCF = Path(os.environ.get("ROBOT_WHEELS") or sysconfig.get_path("purelib"))
pytestmark = pytest.mark.long
# The least share of 200 exactly free configurations that kernels call free, and the least number of 6 solved queries.
ROBOTS = [
    ("panda_description/urdf/panda.urdf", "panda_hand_tcp", 0.85, 6),
    ("ur_description/urdf/ur5_robot.urdf", "tool0", 0.8, 2),  # the upper arm passes the base at 6 mm, closer than hulls
    ("xarm_description/urdf/xarm7.urdf", "link_eef", 0.85, 6),
    ("so_arm_description/urdf/so101.urdf", "gripper_frame_link", 0.85, 5),
    ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", 0.85, 6),
]


@pytest.mark.parametrize(("file", "tool", "called", "solved"), ROBOTS)
def test_a_published_robot_moves(file: str, tool: str, called: float, solved: int) -> None:
    path = _there(DATA / "example-robot-data" / "robots" / file)
    _moves(gp.Scene.from_urdf(path, tool=tool, acceleration=5.0, packages=[DATA]), called, solved)


def test_jaws_of_a_published_robot_hold_a_box_by_friction() -> None:
    pytest.importorskip("coacd")
    path = _there(DATA / "example-robot-data" / "robots" / "so_arm_description" / "urdf" / "so101.urdf")
    world = """<mujoco><worldbody><body name="box" pos="1 0 0"><freejoint/>
      <geom type="box" size=".015 .015 .02" mass=".05" friction="1 .005 .0001" condim="4"/></body></worldbody>
      </mujoco>"""
    scene = gp.Scene.from_urdf(
        path,
        tool="gripper_frame_link",
        acceleration=8.0,
        packages=[DATA],
        world=world,
        decompose=["gripper_link", "moving_jaw_so101_v1_link"],
    )
    X_TO = np.diag([1.0, -1.0, -1.0, 1.0])
    X_TO[:3, 3] = -0.016, 0.0, -0.02  # beside the fixed jaw, 2 cm inwards
    held = scene.attach("box", X_TO=X_TO, fingers=gp.Opening())
    start, goal = [-0.9, 0.2, 0.1, 0.9, 0.0], [0.9, 0.2, 0.1, 0.9, 0.0]
    result = gp.plan(start, goal, held, iterations=50)
    assert fb.execute(result, fb.build_world(held)).slip < 2e-3
    assert fb.validate(result, held, "*/gripper_failure/critical", n=2).dropped.mean == 1.0


@pytest.mark.parametrize(("name", "joints", "solved"), [("kinova3", 7, 6), ("iiwa", 7, 6), ("ur5e", 6, 1)])
def test_a_published_mjcf_arm_moves(name: str, joints: int, solved: int) -> None:
    path = _there(MJCF / "robosuite" / "models" / "assets" / "robots" / name / "robot.xml")
    scene = gp.Scene.from_mjcf(
        path,
        robot="base",
        tool="right_hand",
        velocity=[2.0] * joints,
        acceleration=[5.0] * joints,
        self_collision="links",
    )
    _moves(scene, 0.95, solved)


def test_a_published_fetch_moves_its_arm_at_a_table() -> None:
    file = _there(MJCF / "gymnasium_robotics" / "envs" / "assets" / "fetch" / "reach.xml")
    with pytest.raises(SceneError, match=r"'../stls/fetch'.*folder=DIR"):
        gp.Scene.from_mjcf(file, robot="robot0:", tool="robot0:grip", velocity=[1.0] * 11, acceleration=[3.0] * 11)
    spec = mujoco.MjSpec.from_file(str(file))
    for k in range(3):  # its base is fixed
        spec.delete(spec.joint(f"robot0:slide{k}"))
    scene = gp.Scene.from_mjcf(
        spec, robot="robot0:", tool="robot0:grip", velocity=[0.1] + [1.0] * 7, acceleration=[0.5] + [3.0] * 7
    )
    _moves(scene, 0.9, 6)


def _there(path: Path) -> Path:
    if not path.is_file():
        pytest.skip("make test-robots installs the models")
    return path


def _moves(scene: gp.Scene, called: float, solved: int) -> None:
    lower, upper = scene.limits.position.T
    q = np.random.default_rng(0).uniform(lower, upper, (400, len(scene.joints)))
    judge = Judge(scene)
    touched = {touch.sample for touch in judge.touches(q) if judge.is_violation(touch, at_end=False)}
    free = q[[k for k in range(len(q)) if k not in touched]][:200]
    assert np.mean(compile_scene(scene).kernels.free(free)) >= called
    queries = free[:12].reshape(6, 2, -1)
    # Iterations end hopeless searches; the time limit is for a busy machine.
    given = {"iterations": 20_000, "time_limit": 30.0, "callback": lambda _: True}
    results = [gp.plan(a, b, scene, w=0.0, **given) for a, b in queries]
    assert sum(result.status is gp.PlanStatus.SOLVED for result in results) >= solved
    assert all(gp.verify(r.trajectory, scene).passed for r in results if r.trajectory is not None)


# --- grippers: held by friction or a cup in FailBench, without a weld -------------------------------------------------

BLOCK = """<mujoco><worldbody><body name="block" pos="3 0 1"><freejoint/>
  <geom type="box" size="{0} {0} {1}" mass="{2}" friction="1 .005 .0001" condim="4"/></body></worldbody></mujoco>"""


def _block(half: float, height: float, mass: float) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(BLOCK.format(half, height, mass))


def _stays_until_the_gripper_fails(scene: gp.Scene, q: list[float]) -> None:
    """Turn the first joint by a radian: the healthy gripper keeps the object, a failing one drops it."""
    motion = np.array([q, q])
    motion[:, 0] += -0.5, 0.5
    report = fb.validate(motion, scene, "*/gripper_failure/critical", n=2)
    assert fb.execute(motion, fb.build_world(scene)).slip < 5e-3
    assert report.dropped.mean == 1.0


def _links(file: Path) -> str:
    """Return the links and joints of a URDF, with absolute paths of meshes."""
    text = re.sub(
        r'filename="(?!package)([^"]*)"', lambda m: f'filename="{(file.parent / m[1]).resolve()}"', file.read_text()
    )
    return re.search(r"<robot[^>]*>(.*)</robot>", text, re.DOTALL)[1].replace("drake:", "")


def _mounted(parent: str, links: str, root: str, tool: str) -> str:
    return f"""{links}<joint name="mount" type="fixed"><parent link="{parent}"/><child link="{root}"/></joint>
      <link name="tcp"/><joint name="tcp" type="fixed"><parent link="{root}"/><child link="tcp"/>
      <origin xyz="{tool}"/></joint></robot>"""


def test_ur5e_with_a_2f85_holds_by_friction() -> None:
    models = MJCF / "airo_models"
    arm = _there(models / "arms" / "ur5e" / "ur5e.urdf")
    hand = _links(models / "grippers" / "robotiq_2f_85" / "urdf" / "robotiq_2f_85.urdf").replace('"base_link', '"hand')
    text = '<robot name="ur">' + _links(arm) + _mounted("tool0", hand, "hand", "0 0 .145")
    scene = gp.Scene.from_urdf(text, tool="tcp", acceleration=5.0, packages=[models], world=_block(0.03, 0.04, 0.35))
    X_TO = gp.FROM_ABOVE.copy()
    X_TO[2, 3] = 0.025
    held = scene.attach("block", X_TO=X_TO, fingers=gp.Opening())
    assert gp.GraspHolds().grip(held).half[0] == pytest.approx(0.03, abs=1e-3)
    _stays_until_the_gripper_fails(held, [0.0, -1.2, 1.3, -1.6, -1.57, 0.0])


def test_a_published_panda_holds_by_friction() -> None:
    path = _there(DATA / "example-robot-data" / "robots" / "panda_description" / "urdf" / "panda.urdf")
    scene = gp.Scene.from_urdf(
        path, tool="panda_hand_tcp", acceleration=5.0, packages=[DATA], world=_block(0.02, 0.03, 0.3)
    )
    held = scene.attach("block", X_TO=gp.FROM_ABOVE, fingers=gp.Opening())
    _stays_until_the_gripper_fails(held, [0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8])


def test_a_published_fetch_holds_by_friction() -> None:
    file = _there(MJCF / "gymnasium_robotics" / "envs" / "assets" / "fetch" / "pick_and_place.xml")
    spec = mujoco.MjSpec.from_file(str(file))
    for k in range(3):
        spec.delete(spec.joint(f"robot0:slide{k}"))
    spec.geom("object0").mass = 0.5
    scene = gp.Scene.from_mjcf(
        spec, robot="robot0:", tool="robot0:grip", velocity=[0.1] + [1.0] * 7, acceleration=[0.5] + [3.0] * 7
    )
    X_TO = np.eye(4)
    X_TO[0, 3] = 0.01
    held = scene.attach("object0", X_TO=X_TO, fingers=gp.Opening())
    motion = np.array([[0.2, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.2, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    assert fb.execute(motion, fb.build_world(held)).slip < 5e-3


def test_a_ur10_with_a_vacuum_cup_holds_by_its_force() -> None:
    path = _there(DATA / "example-robot-data" / "robots" / "ur_description" / "urdf" / "ur10_robot.urdf")
    cup = """<link name="cup"><collision><origin xyz="0 0 .03"/>
      <geometry><cylinder radius=".03" length=".06"/></geometry></collision></link>"""
    text = '<robot name="ur">' + _links(path) + _mounted("tool0", cup, "cup", "0 0 .06")
    scene = gp.Scene.from_urdf(text, tool="tcp", acceleration=3.0, packages=[DATA], world=_block(0.05, 0.05, 1.0))
    X_TO = gp.FROM_ABOVE.copy()
    X_TO[2, 3] = 0.05
    held = scene.attach("block", X_TO=X_TO, grip=gp.Adhesion(force=80.0, radius=0.03))
    _stays_until_the_gripper_fails(held, [0.0, -1.2, 1.3, -1.67, -1.57, 0.0])

"""Published robot models, from packages that `make test-robots` installs, can be loaded and planned for."""

from __future__ import annotations

import os
import sysconfig
from pathlib import Path

import mujoco
import numpy as np
import pytest

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

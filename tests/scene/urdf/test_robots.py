"""Robots as their makers publish them, from a package that `make test-robots` installs: they load, and move."""

from __future__ import annotations

import sysconfig
from pathlib import Path

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import Judge

DATA = Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share"
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not (DATA / "example-robot-data").is_dir(), reason="make test-robots installs the models"),
]
# Of 200 configurations that exact geometry calls free, the kernels call so at least this share; of 6 queries so many.
ROBOTS = [
    ("panda_description/urdf/panda.urdf", "panda_hand_tcp", 0.85, 6),
    ("ur_description/urdf/ur5_robot.urdf", "tool0", 0.8, 2),  # the upper arm passes the base at 6 mm, closer than hulls
    ("xarm_description/urdf/xarm7.urdf", "link_eef", 0.85, 6),
    ("so_arm_description/urdf/so101.urdf", "gripper_frame_link", 0.85, 5),
    ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", 0.85, 6),
]


@pytest.mark.parametrize(("file", "tool", "called", "solved"), ROBOTS)
def test_a_published_robot_moves(file: str, tool: str, called: float, solved: int) -> None:
    path = DATA / "example-robot-data" / "robots" / file
    scene = gp.Scene.from_urdf(path, tool=tool, acceleration=5.0, packages=[DATA])
    q = np.random.default_rng(0).uniform(*scene.limits.position.T, (400, len(scene.joints)))
    judge = Judge(scene)
    touched = {touch.sample for touch in judge.touches(q) if judge.is_violation(touch, at_end=False)}
    free = q[[k for k in range(len(q)) if k not in touched]][:200]
    assert np.mean(compile_scene(scene).kernels.free(free)) >= called
    queries = free[:12].reshape(6, 2, -1)
    results = [gp.plan(a, b, scene, w=0.0, time_limit=1.0, callback=lambda _: True) for a, b in queries]
    assert sum(result.status is gp.PlanStatus.SOLVED for result in results) >= solved
    assert all(gp.verify(r.trajectory, scene).passed for r in results if r.trajectory is not None)

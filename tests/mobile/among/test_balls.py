"""Balls around a robot, against all of its spheres one by one."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.mobile.among.balls import FAR, Balls

_COARSE = 0.24
"""By how much balls of this diameter may stick out of the spheres in them [m]."""


@pytest.mark.parametrize("size", [[0.25, 0.85], [0.5, 0.2, 0.3]])
def test_no_sphere_is_closer_than_balls_say_and_none_much_farther(size):
    task = gp.load_scene("hallway").tasks["carry_bottle"]
    rng = np.random.default_rng(0)
    lower, upper = np.clip(task.scene.limits.position.T, -2.0, 2.0)
    q, t = rng.uniform(lower, upper, (300, len(lower))), rng.uniform(0.0, 4.0, 300)
    walk = [[-1.5, -1.0, 0.85], [1.5, 1.0, 0.85]]
    who = gp.MovingEntity("a", "adult", size=size, t=[0.0, 4.0], position=walk, yaw=[0.3, 2.0])
    robot, there = compile_scene(task.scene).robot, who.at(t)
    poses = compile_scene(task.scene).kernels.link_poses(q)
    own = robot.sphere_link > 0
    X, spheres = poses[:, robot.sphere_link[own]], robot.sphere[own]
    away = np.einsum("nsij,sj->nsi", X[..., :3, :3], spheres[:, :3]) + X[..., :3, 3] - there.position[:, None]
    c, s = np.cos(there.yaw)[:, None], np.sin(there.yaw)[:, None]
    x, y = np.abs(c * away[..., 0] + s * away[..., 1]), np.abs(c * away[..., 1] - s * away[..., 0])
    beside = [np.hypot(x, y) - size[0]] if who.is_round else [x - size[0], y - size[1]]
    beyond = np.stack([*beside, np.abs(away[..., 2]) - size[-1]])
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=0) + np.minimum(beyond.max(axis=0), 0.0)
    expected = (outside - spheres[:, 3]).min(axis=1)
    found = Balls(task.scene).gap(q, who, t)
    near = expected < FAR
    assert 50 < near.sum() < 290
    touching = expected < 0.0  # how deep they are in each other is another question
    assert touching.any() and (found[touching] < 0.0).all()
    apart = near & ~touching
    assert (found <= expected + 1e-9)[apart].all() and (found >= expected - _COARSE)[apart].all()
    assert (found >= FAR - _COARSE)[~near].all() and (found <= expected + 1e-9)[~near].all()

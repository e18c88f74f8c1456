from __future__ import annotations

import numpy as np
import pytest

from failbench.policies.batch import EpisodeBatch
from failbench.policies.policy import PolicyError
from failbench.policies.servoing import GravityTorque, Servoing
from failbench.policies.task import tool_pose
from graceful_plan.scene.placement import Placement
from graceful_plan.timing.dynamics import RobotDynamics


def test_gravity_equals_inverse_dynamics_at_rest(easy):
    rng, (low, high) = np.random.default_rng(1), easy.scene.limits.position.T
    fast, slow, still = GravityTorque(easy), RobotDynamics(easy.scene), np.zeros(len(low))
    for q in rng.uniform(low, high, (10, len(low))):
        np.testing.assert_allclose(fast(q), slow(q, still, still), atol=1e-9)


def test_targets_move_within_limits_of_place_and_speed(easy):
    servoing, limits = Servoing(easy), easy.scene.limits
    servoing.begin(easy.start)
    before = servoing.q
    for action in np.random.default_rng(2).uniform(-9.0, 9.0, (40, len(before))):
        servoing.commands("joint_position", action)
        most = easy.settings.speed * limits.velocity * easy.settings.period
        assert (np.abs(servoing.q - before) <= most + 1e-12).all()
        assert (servoing.q >= limits.position[:, 0]).all() and (servoing.q <= limits.position[:, 1]).all()
        before = servoing.q


def test_a_tool_pose_is_reached(easy):
    servoing, placement = Servoing(easy), Placement(easy.scene)
    servoing.begin(easy.start)
    for _ in range(150):
        servoing.commands("tool_pose", easy.tool_goal)
    pose = tool_pose(easy.scene, placement.place(servoing.q))
    np.testing.assert_allclose(pose[4:], easy.tool_goal[4:], atol=1e-4)
    assert abs(pose[:4] @ easy.tool_goal[:4]) == pytest.approx(1.0, abs=1e-6)


def test_joints_follow_velocities(easy):
    batch = EpisodeBatch(easy, 1)
    episode = batch.begin(0, np.random.default_rng(0))
    speed = np.array([0.2, -0.1, 0.1, 0.2, 0.0, 0.1, -0.2])
    for _ in range(25):
        batch.advance({0: ("joint_velocity", speed)})
    moved = episode.observation.q - easy.start
    np.testing.assert_allclose(moved, 0.5 * speed, atol=0.01)


@pytest.mark.parametrize(
    ("kind", "action", "problem"),
    [
        ("joint_position", [0.0] * 6, "has shape"),
        ("joint_velocity", [float("nan")] * 7, "not finite"),
        ("tool_pose", [[0.0] * 7], "has shape"),
        ("command", "up", "not an array of numbers"),
    ],
)
def test_invalid_actions_are_refused(easy, kind, action, problem):
    batch = EpisodeBatch(easy, 1)
    batch.begin(0, np.random.default_rng(0))
    with pytest.raises(PolicyError, match=problem):
        batch.advance({0: (kind, action)})

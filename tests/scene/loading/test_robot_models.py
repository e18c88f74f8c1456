from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.loading.robot_models import robot_file, robots

_TOLERANCE = 1e-9
"""Both sides are chains of seven exact transforms in double precision."""

_DH = [  # a, d, alpha of Craig's convention, as published
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
]
_LOWER = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
_UPPER = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
_MASSES = {
    "link0": 0.629769,
    "link1": 4.970684,
    "link2": 0.646926,
    "link3": 3.228604,
    "link4": 3.587895,
    "link5": 1.225946,
    "link6": 1.666555,
    "link7": 0.735522,
    "hand": 0.73,
    "left_finger": 0.015,
    "right_finger": 0.015,
}


@pytest.fixture(scope="module")
def panda() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(robot_file("panda")))


def _transform(a: float, d: float, alpha: float, theta: float) -> np.ndarray:
    ca, sa, ct, s_t = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    return np.array(
        [
            [ct, -s_t, 0.0, a],
            [s_t * ca, ct * ca, -sa, -d * sa],
            [s_t * sa, ct * sa, ca, d * ca],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _published_link_poses(q: np.ndarray) -> list[np.ndarray]:
    poses = [np.eye(4)]
    for (a, d, alpha), theta in zip(_DH, q, strict=True):
        poses.append(poses[-1] @ _transform(a, d, alpha, theta))
    return poses


def _published_tool_pose(q: np.ndarray) -> np.ndarray:
    X_WF = _published_link_poses(q)[-1] @ _transform(0.0, 0.107, 0.0, 0.0)
    return X_WF @ _transform(0.0, 0.1034, 0.0, -np.pi / 4)


def _kinematics(model: mujoco.MjModel, q: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:7] = q
    mujoco.mj_kinematics(model, data)
    return data


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7))
def test_forward_kinematics_follows_the_published_table(fractions: list[float]) -> None:
    model = mujoco.MjModel.from_xml_path(str(robot_file("panda")))
    q = np.array(_LOWER) + np.array(fractions) * (np.array(_UPPER) - np.array(_LOWER))
    data = _kinematics(model, q)
    for i, X_WL in enumerate(_published_link_poses(q)):
        np.testing.assert_allclose(data.body(f"link{i}").xpos, X_WL[:3, 3], atol=_TOLERANCE)
        np.testing.assert_allclose(data.body(f"link{i}").xmat.reshape(3, 3), X_WL[:3, :3], atol=_TOLERANCE)
    X_WT = _published_tool_pose(q)
    np.testing.assert_allclose(data.site("tool").xpos, X_WT[:3, 3], atol=_TOLERANCE)
    np.testing.assert_allclose(data.site("tool").xmat.reshape(3, 3), X_WT[:3, :3], atol=_TOLERANCE)


def test_tool_at_two_postures_worked_out_by_hand(panda: mujoco.MjModel) -> None:
    upright = _kinematics(panda, np.zeros(7)).site("tool")
    # Arm stretched upwards, wrist folded down: x = 0.088, z = 0.333 + 0.316 + 0.384 - 0.107 - 0.1034.
    np.testing.assert_allclose(upright.xpos, [0.088, 0.0, 0.8226], atol=_TOLERANCE)
    np.testing.assert_allclose(upright.xmat.reshape(3, 3)[:, 2], [0.0, 0.0, -1.0], atol=_TOLERANCE)
    turned = _kinematics(panda, np.array([np.pi / 2, 0, 0, 0, 0, 0, 0])).site("tool")
    np.testing.assert_allclose(turned.xpos, [0.0, 0.088, 0.8226], atol=_TOLERANCE)


def test_limits_are_the_published_ones(panda: mujoco.MjModel) -> None:
    np.testing.assert_allclose(panda.jnt_range[:7], np.transpose([_LOWER, _UPPER]))
    np.testing.assert_allclose(panda.numeric("velocity_limit").data, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_allclose(panda.numeric("acceleration_limit").data, [15, 7.5, 10, 12.5, 15, 20, 20])
    np.testing.assert_allclose(panda.actuator_forcerange[:7, 1], [87] * 4 + [12] * 3)
    np.testing.assert_allclose(panda.jnt_range[7:], [[0, 0.04]] * 2)


def test_masses_are_the_identified_ones(panda: mujoco.MjModel) -> None:
    assert {panda.body(b).name: pytest.approx(panda.body_mass[b]) for b in range(1, panda.nbody)} == _MASSES
    assert panda.body_mass.sum() == pytest.approx(17.452, abs=1e-3)


@pytest.mark.parametrize(("joint", "most"), [(1, 56.0), (2, 30.0), (3, 23.0), (4, 3.0), (5, 3.0)])
def test_gravity_torques_are_in_the_published_range(panda: mujoco.MjModel, joint: int, most: float) -> None:
    rng = np.random.default_rng(0)
    data = mujoco.MjData(panda)
    torques = []
    for _ in range(500):
        data.qpos[:7] = rng.uniform(_LOWER, _UPPER)
        mujoco.mj_forward(panda, data)
        torques.append(abs(data.qfrc_bias[joint]))
    assert 0.8 * most < max(torques) < 1.02 * most + 0.5


def test_nothing_compensates_gravity(panda: mujoco.MjModel) -> None:
    assert not panda.body_gravcomp.any()


def test_servos_hold_a_posture(panda: mujoco.MjModel) -> None:
    q = np.array([0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785])
    panda.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    data = mujoco.MjData(panda)
    data.qpos[:7] = data.ctrl[:7] = q
    mujoco.mj_step(panda, data, nstep=1500)
    assert np.abs(data.qpos[:7] - q).max() < 0.008  # the sag without gravity compensation
    assert np.abs(data.qvel).max() < 1e-3


def test_the_arm_falls_when_its_servos_die(panda: mujoco.MjModel) -> None:
    data = mujoco.MjData(panda)
    data.qpos[:7] = [0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785]
    panda_off = mujoco.MjModel.from_xml_path(str(robot_file("panda")))
    panda_off.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    mujoco.mj_forward(panda_off, data)
    before = data.site("tool").xpos[2]
    mujoco.mj_step(panda_off, data, nstep=400)
    assert data.site("tool").xpos[2] < before - 0.2


def test_fingers_move_as_one_and_oppose_each_other(panda: mujoco.MjModel) -> None:
    data = mujoco.MjData(panda)
    data.qpos[:7] = data.ctrl[:7] = [0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785]
    data.ctrl[7] = 0.03
    mujoco.mj_step(panda, data, nstep=1500)
    np.testing.assert_allclose(data.qpos[7:], 0.03, atol=2e-3)
    left, right = data.geom("left_finger_pad").xpos, data.geom("right_finger_pad").xpos
    # Pad centres stand 7.58 mm behind the finger joints' positions.
    assert np.linalg.norm(left - right) == pytest.approx(2 * (0.03 + 0.00758), abs=4e-3)
    np.testing.assert_allclose((left + right) / 2, data.site("tool").xpos, atol=2e-3)


def test_the_arm_seldom_collides_with_itself(panda: mujoco.MjModel) -> None:
    rng = np.random.default_rng(1)
    data = mujoco.MjData(panda)
    data.qpos[7:] = 0.03
    colliding = 0
    for _ in range(2000):
        data.qpos[:7] = rng.uniform(_LOWER, _UPPER)
        mujoco.mj_kinematics(panda, data)
        mujoco.mj_collision(panda, data)
        colliding += data.ncon > 0
    assert 0.04 < colliding / 2000 < 0.12  # 0.08: real folds, not covers that are too fat


def test_names_of_robots() -> None:
    assert "panda" in robots()
    with pytest.raises(UnknownNameError, match=r"unknown robot 'pandas'; valid: .*panda"):
        robot_file("pandas")

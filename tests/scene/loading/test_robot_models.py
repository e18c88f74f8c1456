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

_LINK5_OUTLINE = (
    (-264, ((44.5, -8.5), (47.3, -7.9), (49.4, -6), (50.2, -3.5), (49.8, 5.3), (47.4, 7.9), (45.6, 8.5))),
    (-240, ((3.3, -54.3), (26.3, -48.4), (48.9, -25.4), (54.8, 5.3), (50.2, 28.6), (24.9, 59.3), (5.7, 64.3))),
    (-200, ((3.1, -47.9), (32.5, -38.3), (46.3, -23.3), (54.1, 21.5), (50.1, 41.7), (22.5, 81.1), (0.8, 84.8))),
    (-160, ((2.2, -37.6), (34.8, -28.3), (46.6, -15.7), (53.4, 37.6), (50, 54.8), (27.7, 91.2), (0.6, 95.4))),
    (-120, ((1.2, -27.3), (37.2, -18.2), (46.8, -8.1), (52.7, 53.7), (49.9, 67.9), (29.1, 99), (2.1, 104.2))),
    (-80, ((0.3, -17), (39.5, -8.2), (47.1, -0.5), (52, 69.9), (49.7, 81), (30.4, 106.7), (3.6, 113))),
    (-40, ((0.6, -6.8), (41.9, 1.8), (47.4, 7.1), (51.3, 86), (49.6, 94.1), (31.8, 114.5), (5.1, 121.8))),
    (0, ((1.5, 3.5), (44.3, 11.8), (47.6, 14.8), (50.6, 102.1), (50.4, 104), (32.9, 122.1), (4.7, 129.7))),
    (30, ((2.2, 11.2), (37.2, 15.8), (41.7, 100.4), (21.1, 118.6), (2.6, 124.8))),
    (45, ((2.6, 15), (16.6, 15.8), (26, 98.6), (20.6, 102.6), (1.8, 109))),
    (51.5, ((4.3, 84.7), (8.7, 97.9), (3.5, 99))),
)
"""Height in the frame of link 5 and the outermost points (x, y) of its convex outline there, the half with x >= 0 [mm]:
measured on the collision mesh that the manufacturer publishes (franka_description, Apache-2.0), good to 0.1 mm."""


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


@settings(max_examples=30, deadline=None)
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
    assert np.abs(data.qpos[:7] - q).max() < 0.008  # sag without gravity compensation
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
    assert 0.04 < colliding / 2000 < 0.12  # 0.08: real folds, not overly large covers


def test_the_geoms_of_the_forearm_hold_all_of_its_published_outline(panda: mujoco.MjModel) -> None:
    half = np.array([(x, y, z) for z, points in _LINK5_OUTLINE for x, y in points])
    outline = 1e-3 * np.concatenate([half, half * [-1.0, 1.0, 1.0]])
    outside = []
    for geom in np.flatnonzero(panda.geom_bodyid == panda.body("link5").id):
        assert panda.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, panda.geom_quat[geom])
        p = (outline - panda.geom_pos[geom]) @ R.reshape(3, 3)
        radius, half_length = panda.geom_size[geom, :2]
        p[:, 2] -= np.clip(p[:, 2], -half_length, half_length)
        outside.append(np.linalg.norm(p, axis=1) - radius)
    assert np.min(outside, axis=0).max() <= 0.0


def test_names_of_robots() -> None:
    assert "panda" in robots()
    with pytest.raises(UnknownNameError, match=r"'pandas'.*panda"):
        robot_file("pandas")

"""Differential kinematics of the tool: against MuJoCo, finite differences, and the laws of rotations."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.core.compile import compile_scene
from graceful_plan.core.tool_motion import (
    damped_step,
    matrix_vector,
    missing_twist,
    rotation_matrix,
    steps_inside,
    tool_jacobian,
    without_yaw,
)

_TOLERANCE = 1e-12
"""Rounding of sums of a few products of order 1."""

_vectors = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)


@pytest.fixture(scope="module")
def kernels(scene):
    return compile_scene(scene).kernels


@pytest.fixture(scope="module")
def q(scene):
    return np.random.default_rng(0).uniform(*scene.limits.position.T, size=(20, 7))


def test_jacobian_is_mujocos(scene, kernels, q):
    X_WT, jacobian = tool_jacobian(kernels, q)
    site, full = scene.model.site(scene.tool).id, np.empty((6, scene.model.nv))
    dofs = scene.model.jnt_dofadr[[scene.model.joint(name).id for name in scene.joints]]
    for i, configuration in enumerate(q):
        data = scene.data_at(configuration)
        mujoco.mj_comPos(scene.model, data)
        mujoco.mj_jacSite(scene.model, data, full[:3], full[3:], site)
        np.testing.assert_allclose(jacobian[i], full[:, dofs], atol=_TOLERANCE)
        np.testing.assert_allclose(X_WT[i, :3, 3], data.site_xpos[site], atol=_TOLERANCE)


@pytest.mark.parametrize("free_yaw", [False, True])
def test_missing_twist_changes_by_the_jacobian(kernels, q, free_yaw):
    """At the pose, by finite differences."""
    X_WT, jacobian = tool_jacobian(kernels, q)
    if free_yaw:
        jacobian = without_yaw(X_WT, jacobian)
    h = 1e-6
    for joint in range(q.shape[1]):
        moved = q.copy()
        moved[:, joint] += h
        missing = missing_twist(kernels.tool_pose(moved), X_WT, free_yaw=free_yaw)
        np.testing.assert_allclose(-missing / h, jacobian[:, :, joint], atol=5e-6)


@pytest.mark.parametrize("free_yaw", [False, True])
def test_steps_reach_a_near_pose(kernels, q, free_yaw):
    goal = kernels.tool_pose(q + 0.01)
    for _ in range(6):
        X_WT, jacobian = tool_jacobian(kernels, q)
        q = q + damped_step(
            missing_twist(X_WT, goal, free_yaw=free_yaw), without_yaw(X_WT, jacobian) if free_yaw else jacobian
        )
    assert np.abs(missing_twist(kernels.tool_pose(q), goal, free_yaw=free_yaw)).max() < 1e-8


def test_steps_stay_inside_and_wishes_do_not_move_the_tool(scene, kernels, q):
    limits = tuple(scene.limits.position.T)
    _, jacobian = tool_jacobian(kernels, q)
    wish = 0.01 * np.random.default_rng(1).normal(size=q.shape)
    step, held = steps_inside(np.zeros((len(q), 6)), jacobian, q, limits, wish)
    assert not held.any() and np.abs(step).max() > 1e-4
    assert np.abs(np.einsum("nij,nj->ni", jacobian, step)).max() < 1e-6
    at_limit = q.copy()
    at_limit[:, 3] = limits[1][3]
    _, jacobian = tool_jacobian(kernels, at_limit)
    twist = 1e-3 * jacobian[:, :, 3]
    step, held = steps_inside(twist, jacobian, at_limit, limits)
    assert (at_limit + step <= limits[1]).all() or held.any()
    assert (step[held] == 0.0).all()


@given(vector=_vectors)
def test_rotations_there_and_back(vector):
    R = rotation_matrix(vector[None])
    np.testing.assert_allclose(R[0] @ R[0].T, np.eye(3), atol=_TOLERANCE)
    np.testing.assert_allclose(matrix_vector(R)[0], vector, atol=1e-8)


def test_nothing_is_missing_at_a_pose(kernels, q):
    X_WT = kernels.tool_pose(q)
    assert np.abs(missing_twist(X_WT, X_WT)).max() < 1e-9

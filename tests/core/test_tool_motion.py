"""Differential kinematics of the tool: against MuJoCo and finite differences; laws of rotations."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets
from graceful_plan.core.tool_motion import (
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
    """The Jacobian at the pose equals finite differences."""
    X_WT, jacobian = tool_jacobian(kernels, q)
    if free_yaw:
        jacobian = without_yaw(X_WT, jacobian)
    h = 1e-6
    for joint in range(q.shape[1]):
        moved = q.copy()
        moved[:, joint] += h
        missing = missing_twist(kernels.tool_pose(moved), X_WT, free_yaw=free_yaw)
        np.testing.assert_allclose(-missing / h, jacobian[:, :, joint], atol=5e-6)


def _targets(kernels, q, seed=1):
    """Return random reachable tool poses, and which of them leave the yaw free."""
    rng = np.random.default_rng(seed)
    anywhere = rng.uniform(kernels.robot.lower, kernels.robot.upper, q.shape)
    return kernels.tool_pose(anywhere), np.arange(len(q)) % 2 == 1


def _twist(kernels, q, X_WG, free_yaw):
    missing = missing_twist(kernels.tool_pose(q), X_WG)
    missing[free_yaw] = missing_twist(kernels.tool_pose(q[free_yaw]), X_WG[free_yaw], free_yaw=True)
    return missing


def _numpy_step(kernels, q, X_WG, free_yaw):
    """Take one damped step, then repeat it without the joints that would leave their limits."""
    X_WT, jacobian = tool_jacobian(kernels, q)
    jacobian[free_yaw] = without_yaw(X_WT[free_yaw], jacobian[free_yaw])
    missing = _twist(kernels, q, X_WG, free_yaw)
    lower, upper = kernels.robot.lower, kernels.robot.upper

    def step(jacobian):
        damping = 1e-2 * (missing**2).sum(axis=1) + 1e-9
        gram = jacobian @ jacobian.transpose(0, 2, 1) + damping[:, None, None] * np.eye(6)
        step = np.einsum("nij,ni->nj", jacobian, np.linalg.solve(gram, missing[..., None])[..., 0])
        return step * np.minimum(1.0, 0.5 / np.abs(step).max(axis=1, keepdims=True))

    first = step(jacobian)
    blocked = (q + first < lower) & (first < 0.0) | (q + first > upper) & (first > 0.0)
    return np.clip(q + step(np.where(blocked[:, None], 0.0, jacobian)), lower, upper), blocked


def test_one_iteration_is_a_damped_step_beside_the_limits(kernels, q):
    q = np.clip(3.0 * q, kernels.robot.lower, kernels.robot.upper)  # many joints are at a limit
    X_WG, free_yaw = _targets(kernels, q)
    expected, blocked = _numpy_step(kernels, q, X_WG, free_yaw)
    assert blocked.any(axis=1).sum() > 4
    ended, missing = kernels.reach(q, X_WG, free_yaw, iterations=1, patience=9)
    np.testing.assert_allclose(ended, expected, atol=1e-7)
    np.testing.assert_allclose(missing, _twist(kernels, ended, X_WG, free_yaw), atol=1e-9)


@pytest.mark.parametrize("isa", instruction_sets())
def test_seeds_reach_near_poses_as_exactly_as_doubles_allow(scene, kernels, q, isa):
    compiled = compile_scene(scene)
    own = Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa)
    X_WG, free_yaw = kernels.tool_pose(q + 0.01), np.arange(len(q)) % 2 == 1
    ended, missing = own.reach(q, X_WG, free_yaw, iterations=20, patience=9)
    assert np.abs(missing).max() < 1e-10
    assert np.abs(_twist(kernels, ended, X_WG, free_yaw)).max() < 1e-9


def test_a_seed_ends_the_same_alone_and_in_a_batch(kernels, q):
    X_WG, free_yaw = _targets(kernels, q)
    together = kernels.reach(q, X_WG, free_yaw, iterations=30, patience=5)
    for i in range(len(q)):
        alone = kernels.reach(q[i : i + 1], X_WG[i : i + 1], free_yaw[i : i + 1], iterations=30, patience=5)
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], all_of_them[i])


def test_seeds_end_where_they_make_no_progress(kernels, q):
    X_WG, free_yaw = _targets(kernels, q)
    X_WG[:, :3, 3] += 5.0  # out of reach
    impatient, _ = kernels.reach(q, X_WG, free_yaw, iterations=60, patience=1)
    once, _ = kernels.reach(q, X_WG, free_yaw, iterations=1, patience=60)
    np.testing.assert_array_equal(impatient, once)


@pytest.mark.parametrize("n", [0, 1, 3, 19])
def test_any_number_of_seeds_will_do(kernels, q, n):
    X_WG, free_yaw = _targets(kernels, q)
    ended, missing = kernels.reach(q[:n], X_WG[:n], free_yaw[:n], iterations=5, patience=9)
    assert ended.shape == (n, 7) and missing.shape == (n, 6)
    np.testing.assert_allclose(missing, _twist(kernels, ended, X_WG[:n], free_yaw[:n]), atol=1e-9)


def test_held_joints_stay(kernels, q):
    X_WG, _ = _targets(kernels, q)
    free_yaw = np.zeros(len(q), dtype=bool)
    ended, _ = kernels.reach(q, X_WG, free_yaw, iterations=30, patience=30, held=slice(2, 4))
    np.testing.assert_array_equal(ended[:, 2:4], q[:, 2:4])
    assert (ended != q).mean(axis=0)[[0, 1, 4, 5, 6]].min() > 0.5


def test_half_a_turn_is_missing(kernels, q):
    X_WG = kernels.tool_pose(q)
    X_WG[:, :3, :3] = X_WG[:, :3, :3] @ np.diag([1.0, -1.0, -1.0])  # a turn about x also flips the z axis
    for free_yaw in (False, True):
        _, missing = kernels.reach(q, X_WG, np.full(len(q), free_yaw), iterations=0, patience=1)
        np.testing.assert_allclose(np.linalg.norm(missing[:, 3:], axis=1), np.pi, atol=1e-6)


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

"""Tolerances of a pose make it a set: its reachable poses are found, and the cheap ones come first."""

import numpy as np
import pytest
from goal_arms import ARMS, arm

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.query.endpoints.ik import solve_ik
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.scene.pose_goal import pose_error
from sizes import first_quick

SCENES = {name: arm(name) for name in ARMS}


def turned(rng, angle):
    """Return a rotation about a random axis."""
    axis = rng.normal(size=3)
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def reachable(scene, rng, position, angle, **given):
    """Return a goal within whose tolerances a random configuration reaches, but not more exactly than half of them."""
    X = compile_scene(scene).kernels.tool_pose(rng.uniform(*scene.limits.position.T)).copy()
    off = rng.normal(size=3)
    X[:3, 3] += rng.uniform(0.5, 0.8) * position * off / np.linalg.norm(off)
    X[:3, :3] = X[:3, :3] @ turned(rng, rng.uniform(0.5, 0.8) * min(angle, np.pi))
    return gp.PoseGoal(X, position, angle, **given)


KINDS = {
    "exact": (1e-3, 0.01, {}),
    "wide turn": (1e-3, 0.6, {}),
    "any turn": (1e-3, np.pi, {}),
    "cone": (1e-3, 0.3, {"free_yaw": True}),
    "ball": (0.05, 0.05, {}),
    "both": (0.03, 0.5, {}),
}


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_reachable_within_the_tolerances_is_found(name, kind):
    scene, rng = SCENES[name], np.random.default_rng(1)
    position, angle, given = KINDS[kind]
    missed = []
    for number in range(8):
        goal = reachable(scene, rng, position, angle, **given)
        start = np.mean(scene.limits.position, axis=1)
        found = solve_ik(goal, scene, start)
        for q in found.q:
            distance, turn = pose_error(goal, compile_scene(scene).kernels.tool_pose(q))
            assert distance <= position and turn <= angle
        missed += [] if len(found.q) else [number]
    assert not missed


@pytest.mark.long
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("kind", KINDS)
def test_two_hundred_reachable_goals_are_found(name, kind):
    scene, rng = SCENES[name], np.random.default_rng(2)
    position, angle, given = KINDS[kind]
    start = np.mean(scene.limits.position, axis=1)
    found = [len(solve_ik(reachable(scene, rng, position, angle, **given), scene, start).q) for _ in range(200)]
    assert all(found)


@pytest.mark.parametrize("name", ["five", "seven"])
def test_plans_end_within_wide_tolerances(name):
    scene, rng = SCENES[name], np.random.default_rng(3)
    start = np.mean(scene.limits.position, axis=1)
    for _ in range(2):
        goal = reachable(scene, rng, 0.01, 0.6)
        result = gp.plan(start, goal, scene, w=0.0, iterations=20)
        assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["goal"].passed


def test_many_poses_at_once_are_sets_too():
    scene, rng = SCENES["five"], np.random.default_rng(4)
    start = np.mean(scene.limits.position, axis=1)
    goals = [reachable(scene, rng, 0.01, 0.6) for _ in range(30)]
    result = gp.plan(start, goals, scene, w=0.0, iterations=20)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["goal"].passed


def test_a_narrow_tolerance_is_no_room_for_a_shorter_motion():
    """Where the pose itself can be reached, it is."""
    scene, rng = SCENES["seven"], np.random.default_rng(5)
    start = np.mean(scene.limits.position, axis=1)
    X = compile_scene(scene).kernels.tool_pose(rng.uniform(*scene.limits.position.T))
    for q in solve_ik(gp.PoseGoal(X), scene, start).q:
        assert max(pose_error(gp.PoseGoal(X), compile_scene(scene).kernels.tool_pose(q))) < 1e-5


def test_a_wide_tolerance_shortens_the_motion():
    scene, rng = SCENES["six"], np.random.default_rng(6)
    start = np.array([0.1, -0.4, 0.9, 0.2, 0.5, 0.3])
    shorter = 0
    for _ in range(10):
        X = compile_scene(scene).kernels.tool_pose(start + 0.4 * rng.normal(size=6))
        narrow, wide = (solve_ik(gp.PoseGoal(X, 1e-3, angle), scene, start).q[0] for angle in (0.01, 0.4))
        shorter += np.linalg.norm(wide - start) < np.linalg.norm(narrow - start) - 1e-3
    assert shorter >= 9


@pytest.mark.parametrize("seed", first_quick(range(6)))
def test_a_dear_joint_moves_as_little_as_it_has_to(seed):
    """A rail of weight 20: hardly any of many random solutions is cheaper."""
    scene, rng = SCENES["rail"], np.random.default_rng(seed)
    start = np.array([0.2, 0.1, -0.4, 0.9, 0.2, 0.5, 0.3])
    X = compile_scene(scene).kernels.tool_pose(start + 0.3 * rng.normal(size=7))
    weights = (20.0, *[1.0] * 6)
    travel = Travel(start, gp.Objective(motion=gp.JointLength(weights), w=0.0).bind(scene))
    weighted, plain = (solve_ik(gp.PoseGoal(X), scene, start, travel=one).q[0] for one in (travel, None))
    assert travel.cost(weighted[None])[0] < travel.cost(plain[None])[0]
    kernels = compile_scene(scene).kernels
    seeds = np.clip(start + 0.6 * rng.normal(size=(1000, 7)), *scene.limits.position.T)
    q, missing = kernels.reach(
        seeds, np.broadcast_to(X, (1000, 4, 4)), np.zeros(1000, dtype=bool), iterations=60, patience=20,
        ease=travel.ease,
    )  # fmt: skip
    others = q[np.linalg.norm(missing, axis=1) < 1e-7]
    assert len(others) > 100
    assert travel.cost(weighted[None])[0] < 1.02 * travel.cost(others).min()


def test_plan_ranks_goals_by_the_objective():
    scene = SCENES["rail"]
    start = np.array([0.2, 0.1, -0.4, 0.9, 0.2, 0.5, 0.3])
    X = compile_scene(scene).kernels.tool_pose(start + [0.0, 0.3, 0.2, -0.2, 0.1, 0.0, 0.1])
    dear = gp.Objective(motion=gp.JointLength((20.0, *[1.0] * 6)), w=0.0)
    plain, weighted = (
        gp.plan(start, gp.PoseGoal(X), scene, objective=objective, iterations=20).trajectory.q[-1, 0] - start[0]
        for objective in (gp.Objective(w=0.0), dear)
    )
    assert abs(weighted) < 0.02 and abs(weighted) <= abs(plain)


def test_any_motion_cost_ranks_goals():
    scene, start = SCENES["planar"], np.zeros(3)
    weights = gp.JointLength((1.0, 2.0, 3.0))
    direct = Travel(start, gp.Objective(motion=weights, w=0.0).bind(scene))
    summed = Travel(start, gp.Objective(motion=1.0 * weights, w=0.0).bind(scene))
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 3))
    np.testing.assert_allclose(summed.cost(q), direct.cost(q), rtol=1e-9)
    np.testing.assert_allclose(summed.ease, direct.ease, rtol=1e-6)
    np.testing.assert_allclose(direct.ease, [1.0, 1.0 / 4.0, 1.0 / 9.0])
    assert Travel(start).cost(q) == pytest.approx(np.linalg.norm(q, axis=1))

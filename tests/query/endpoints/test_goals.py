"""Starts and goals: all accepted forms, clamping, and reasons for refusal."""

from __future__ import annotations

import re

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.exceptions import NonFiniteError, ShapeError, UnknownNameError
from graceful_plan.judge.exact import exactly_free, state_contacts
from graceful_plan.query.endpoints import usable as usable_module
from graceful_plan.query.endpoints.endpoints import find_endpoints
from graceful_plan.query.endpoints.goals import resolve_goal, resolve_start
from graceful_plan.query.endpoints.usable import MOST_GOALS
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene


@pytest.fixture(scope="module")
def scene(scene: Scene) -> Scene:
    return scene.tasks["lift_to_goal"].scene


@pytest.fixture(scope="module")
def start(scene: Scene) -> np.ndarray:
    return scene.tasks["lift_to_goal"].start


@pytest.fixture(scope="module")
def colliding(scene: Scene) -> np.ndarray:
    anywhere = np.random.default_rng(0).uniform(*scene.limits.position.T, size=(100, 7))
    return next(q for q in anywhere if state_contacts(q, scene))


def test_a_configuration_and_a_keyframe(scene: Scene, start: np.ndarray) -> None:
    for given, expected in ((start, start), (start.tolist(), start), ("ready", scene.keyframes["ready"])):
        resolved = resolve_start(given, scene)
        np.testing.assert_array_equal(resolved.q, [expected])
        assert resolved.detail == ""
        np.testing.assert_array_equal(resolve_goal(given, scene, start).q, [expected])


def test_several_goals_keep_their_order_and_index(scene: Scene, start: np.ndarray, colliding: np.ndarray) -> None:
    resolved = resolve_goal([start, colliding, scene.keyframes["ready"]], scene, start)
    np.testing.assert_array_equal(resolved.q, [start, scene.keyframes["ready"]])
    assert resolved.index == (0, 2)
    assert len(resolved.problems) == 1 and resolved.problems[0].startswith("goal 1: ")
    mixed = resolve_goal(["ready", start], scene, start)
    np.testing.assert_array_equal(mixed.q, [scene.keyframes["ready"], start])


def test_usable_goals_are_those_accepted_by_exact_geometry(scene: Scene, start: np.ndarray) -> None:
    lower, upper = scene.limits.position.T
    goals = np.random.default_rng(1).uniform(lower - 0.05, upper + 0.05, (300, 7))
    resolved = resolve_goal(goals, scene, start)
    inside = ((goals >= lower) & (goals <= upper)).all(axis=1)
    expected = [k for k in np.flatnonzero(inside) if not state_contacts(goals[k], scene)]
    assert list(resolved.index) == expected and 20 < len(expected) < 280
    np.testing.assert_array_equal(resolved.q, goals[expected])
    assert any(" of 300 " in problem for problem in resolved.problems)


def test_of_too_many_goals_the_nearest_are_planned_for(scene: Scene, start: np.ndarray) -> None:
    """If the time ends, the choice is among checked goals: those that spheres prove free, from the start."""
    goals = np.clip(start + np.random.default_rng(2).normal(0.0, 0.3, (3000, 7)), *scene.limits.position.T)
    resolved = resolve_goal(goals, scene, start)
    assert len(resolved.index) == MOST_GOALS and "1000 nearest" in resolved.notes[0]
    away = np.linalg.norm(goals - start, axis=1)
    assert away[list(resolved.index)].max() < np.median(away)
    hurried = resolve_goal(goals, scene, start, cancelled=lambda: True)
    assert len(hurried.index) and "of 300" in hurried.detail
    assert set(exactly_free(hurried.q, scene)) == {True}


def test_of_twenty_thousand_goals_only_the_nearest_are_looked_at(
    scene: Scene, start: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    monkeypatch.setattr(usable_module, "exactly_free", lambda q, scene: seen.extend(q) or exactly_free(q, scene))
    goals = np.random.default_rng(3).uniform(*scene.limits.position.T, (20_000, 7))
    resolved = resolve_goal(goals, scene, start)
    assert len(resolved.index) == MOST_GOALS and len(seen) < 4000
    away = np.linalg.norm(goals - start, axis=1)
    nearest = np.argsort(away)[: len(seen) + MOST_GOALS]
    assert set(resolved.index) <= set(nearest.tolist())
    passed_over = np.setdiff1d(np.flatnonzero(away < away[list(resolved.index)].max()), resolved.index)
    assert len(passed_over) > 100 and not exactly_free(goals[passed_over], scene).any()


def test_without_time_goals_are_checked_up_to_a_usable_one(
    scene: Scene, start: np.ndarray, colliding: np.ndarray
) -> None:
    """Goals that collide except the last one, and goals of which the first are free."""
    goals = np.tile(colliding, (300, 1))
    goals[-1] = scene.keyframes["ready"]
    late = start + np.sign(colliding - start) * np.abs(colliding - scene.keyframes["ready"]).max()
    assert resolve_goal(goals, scene, late, hurried=lambda: True).index == (299,)
    goals[:30] = start
    several: list[object] = [*goals, PoseGoal.at([3.0, 0.0, 0.5])]
    for given in (goals, several):
        resolved = resolve_goal(given, scene, start, hurried=lambda: True)
        assert set(range(30)) <= set(resolved.index) and "of 300" in resolved.detail
    assert resolve_goal(several, scene, start).index == (*range(30), 299)
    # Batches of 64: collisions of the first batch are found, the others are unchecked.
    goals[:] = colliding
    goals[-1] = start
    assert "235 of 300" in resolve_goal(goals, scene, start, cancelled=lambda: True).detail


def test_a_goal_among_a_thousand_that_cannot_be_used_is_found(scene: Scene, start: np.ndarray) -> None:
    goals = np.tile(scene.limits.position[:, 1] + 0.5, (1000, 1))
    goals[700] = scene.keyframes["ready"]
    result = gp.plan(start, goals, scene, w=0.0, iterations=50)
    assert (result.status, result.goal_index) == (gp.PlanStatus.SOLVED, 700)


@pytest.mark.long
@pytest.mark.parametrize("count", [300, 1000, 20_000])
@pytest.mark.parametrize("every", [None, 10])
def test_usable_goals_of_many_are_planned_for(scene: Scene, start: np.ndarray, count: int, every: int) -> None:
    """A single usable goal, or one in ten; the benchmark `hardening` measures the time."""
    q = np.random.default_rng(1).uniform(*scene.limits.position.T, (2 * count + 1000, 7))
    clearance = gp.clearance(q, scene)
    blocked, clear = q[clearance < -0.05], q[clearance > 0.0]
    goals = blocked[np.arange(count) % len(blocked)]
    usable = [count // 2] if every is None else list(range(0, count, every))
    goals[usable] = clear[np.arange(len(usable)) % len(clear)]
    result = gp.plan(start, goals, scene, iterations=50)
    assert result.status is gp.PlanStatus.SOLVED and result.goal_index in usable


def test_a_set_of_poses_is_tried_from_the_nearest_on(scene: Scene, start: np.ndarray) -> None:
    """Grasps all around a place: the nearest ones suffice, and unreachable ones are reported."""
    tool = Placement(scene).place(start).site(scene.tool)
    near, far = tool.xpos + [0.0, 0.0, 0.02], tool.xpos + [0.0, 0.1, 0.05]
    down = [0.0, 1.0, 0.0, 0.0]
    beyond, away, here = PoseGoal.at([3.0, 0.0, 0.5], down), PoseGoal.at(far, down), PoseGoal.at(near, down)
    resolved = resolve_goal([beyond, away, "ready", here], scene, start)
    assert set(resolved.index) == {1, 2, 3} and resolved.index[0] == 2
    assert list(resolved.index).index(3) < list(resolved.index).index(1)
    assert any(problem.startswith("goal 0: ") for problem in resolved.problems)
    for q, k in zip(resolved.q, resolved.index, strict=True):
        if k != 2:
            reached = Placement(scene).place(q).site(scene.tool).xpos
            np.testing.assert_allclose(reached, {1: far, 3: near}[k], atol=1e-3)
    few = resolve_goal([away] * 3 + [here] * 5, scene, start)
    assert 8 <= len(few.index) <= 9 and not {0, 1, 2} & set(few.index)
    assert len(resolve_goal([beyond, beyond], scene, start).q) == 0


def test_a_plan_to_a_set_of_poses_names_the_reached_one(scene: Scene, start: np.ndarray) -> None:
    tool = Placement(scene).place(start).site(scene.tool)
    poses = [PoseGoal.at(tool.xpos + [0.0, 0.05 * k, 0.1], [0.0, 1.0, 0.0, 0.0], free_yaw=True) for k in (9, 1, 2)]
    result = gp.plan(start, poses, scene, w=0.0, iterations=200)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert result.goal_index is not None
    assert gp.verify(result.trajectory, scene, goal=poses[result.goal_index]).checks["goal"].passed
    through = gp.plan(start, poses, scene, w=0.0, via=["ready"], iterations=600)
    assert through.status is gp.PlanStatus.SOLVED, through.detail
    assert gp.verify(through.trajectory, scene, goal=poses[through.goal_index or 0]).checks["goal"].passed


def test_a_collision_names_the_pair_and_its_depth(scene: Scene, colliding: np.ndarray) -> None:
    resolved = resolve_start(colliding, scene)
    contact = state_contacts(colliding, scene)[0]
    assert len(resolved.q) == 0
    names = [name.partition("#")[0] for name in (contact.first, contact.second)]
    assert f"AllowedContact({names[0]!r}, {names[1]!r})" in resolved.detail
    scene.geoms_named(names[0]), scene.geoms_named(names[1])  # these names are valid
    assert f"{1e3 * contact.depth:.3g} mm" in resolved.detail


def test_one_goal_needs_no_number_and_one_contact_no_others(scene: Scene, start: np.ndarray) -> None:
    anywhere = np.random.default_rng(0).uniform(*scene.limits.position.T, size=(200, 7))
    for count, more in ((1, ""), (2, " and 1 more")):
        q = next(q for q in anywhere if len(state_contacts(q, scene)) == count)
        alone, both = resolve_goal(q, scene, start), resolve_goal([q, start], scene, start)
        assert alone.detail.startswith("goal: ") and both.detail.startswith("goal 0: ")
        assert f" mm in {state_contacts(q, scene)[0].second}{more}" in alone.detail


@pytest.mark.parametrize("side", [0, 1])
def test_slight_excess_is_clamped_and_reported(scene: Scene, side: int) -> None:
    q = np.array(scene.keyframes["ready"])
    limit = scene.limits.position[2, side]
    outside = q.copy()
    outside[2] = limit + (1e-6 if side else -1e-6) * 0.99
    q[2] = limit
    resolved = resolve_start(outside, scene)
    assert "panda/joint3" in resolved.notes[0] and "moved onto it" in resolved.notes[0]
    assert ["lower", "upper"][side] in resolved.notes[0]
    if len(resolved.q):  # if that configuration is free
        np.testing.assert_array_equal(resolved.q, [q])
    else:
        assert state_contacts(q, scene)


def test_outside_names_joint_value_and_limit(scene: Scene, start: np.ndarray) -> None:
    q = start.copy()
    q[0] = 3.0
    resolved = resolve_start(q, scene)
    assert len(resolved.q) == 0 and resolved.notes == ()
    assert re.search("'panda/joint1'.* 3, .*2.8973", resolved.detail)


def test_a_pose_gives_free_configurations_near_first(scene: Scene, start: np.ndarray) -> None:
    resolved = resolve_goal(PoseGoal.at([0.5, 0.1, 0.4], [0.0, 1.0, 0.0, 0.0]), scene, start)
    assert len(resolved.q) > 1 and set(resolved.index) == {0}
    assert all(state_contacts(q, scene) == [] for q in resolved.q)
    assert (np.diff(np.linalg.norm(resolved.q - start, axis=1)) >= 0.0).all()


def test_a_pose_in_collision_and_one_out_of_reach(scene: Scene, start: np.ndarray) -> None:
    blocked = resolve_goal(PoseGoal.at([0.5, 0.1, 0.01], [0.0, 1.0, 0.0, 0.0]), scene, start)
    assert len(blocked.q) == 0 and "collide" in blocked.detail and " mm in " in blocked.detail
    far = resolve_goal(PoseGoal.at([2.0, 0.0, 0.5]), scene, start)
    assert len(far.q) == 0 and "pose" in far.detail


def test_misuse_raises(scene: Scene, start: np.ndarray) -> None:
    with pytest.raises(ShapeError, match="start has shape"):
        resolve_start(start[:6], scene)
    with pytest.raises(NonFiniteError, match=r"start.*finite"):
        resolve_start(np.full(7, np.nan), scene)
    with pytest.raises(UnknownNameError, match=r"'redy'.*ready"):
        resolve_start("redy", scene)
    with pytest.raises(UnknownNameError, match="unknown keyframe"):
        resolve_goal(["ready", "nope"], scene, start)
    for goal in (np.zeros((0, 7)), np.zeros((1, 1, 7)), start[:3]):
        with pytest.raises(ShapeError, match="goal has shape"):
            resolve_goal(goal, scene, start)


def test_joints_without_an_end_turn_the_short_way() -> None:
    text = """<robot name="arm"><link name="base"/>
    <link name="hand"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
    <joint name="wrist" type="continuous"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
    <limit velocity="2" effort="40"/></joint></robot>"""
    wrist = gp.Scene.from_urdf(text, tool="hand", acceleration=8.0)
    assert wrist.endless.all()
    lower, upper = wrist.limits.position[0]
    for start in (-3.0, 0.0, 3.0):
        for goal in np.linspace(-3.1, 3.1, 9):
            (found,) = resolve_goal([goal], wrist, np.array([start])).q
            assert abs(np.exp(1j * found[0]) - np.exp(1j * goal)) < 1e-9
            assert lower <= found[0] <= upper
            assert abs(found[0] - start) <= np.pi + 1e-9 or not lower <= start + np.pi <= upper
    (near,) = resolve_goal([-3.0], wrist, np.array([3.0])).q
    assert near[0] == pytest.approx(2.0 * np.pi - 3.0)


def test_a_pose_that_cannot_be_looked_for_in_time_is_a_timeout(scene: Scene, start: np.ndarray) -> None:
    away = PoseGoal.at([3.0, 0.0, 0.5])
    found = find_endpoints(start, away, SceneConstraints(scene, ()), np.random.default_rng(0), late=lambda _: True)
    assert found.status is gp.PlanStatus.TIMEOUT
    found = find_endpoints(start, away, SceneConstraints(scene, ()), np.random.default_rng(0))
    assert found.status is gp.PlanStatus.INVALID_GOAL


_SLEDGE = """<mujoco><worldbody><geom name="floor" type="plane" size="3 3 .1"/>
  <body name="sledge" pos="0 0 .051"><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
    <geom name="runner" type="box" size=".2 .1 .05"/><site name="tip"/></body></worldbody></mujoco>"""


def test_where_nothing_leads_out_of_a_tight_place_the_nearest_pair_is_named():
    def sledge(*allowed):
        return gp.Scene.from_mjcf(
            _SLEDGE, robot="sledge", tool="tip", velocity=[1.0], acceleration=[1.0], allowed_contacts=allowed
        )

    result = gp.plan([0.0], [0.5], sledge(), w=0.0, time_limit=20.0)
    assert result.status is gp.PlanStatus.INVALID_START
    assert result.detail.endswith("runner is 1 mm from floor; if they may touch, say AllowedContact('runner', 'floor')")
    allowed = sledge(gp.AllowedContact("runner", "floor"))
    assert gp.plan([0.0], [0.5], allowed, w=0.0, iterations=100).status is gp.PlanStatus.SOLVED

"""Certificates: never better than dense sampling, exact where the true value is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.analysis.certificate import certify, lower_bound
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.plan import plan
from graceful_plan.result import Certificate, PlanStatus
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@pytest.fixture(scope="module")
def tabletop() -> Scene:
    return load_scene("tabletop").tasks["green_to_blue"].scene


@dataclass(frozen=True)
class Field(Cost):
    """A constant cost."""

    constant: float

    def state(self, batch: StateBatch) -> Array:
        return np.full(len(batch), self.constant)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_no_path_to_a_pose_is_shorter_than_the_lower_bound(tabletop: Scene, seed: int):
    rng = np.random.default_rng(seed)
    lower, upper = tabletop.limits.position.T
    start, end = rng.uniform(lower, upper, size=(2, len(lower)))
    end = start + rng.uniform(0.0, 1.0) * (end - start)
    objective = Objective().bind(tabletop)
    pose = PoseGoal(compile_scene(tabletop).kernels.tool_pose(end))
    bound = lower_bound(start, pose, objective)
    assert bound is not None and 0.0 <= bound <= float(np.linalg.norm(end - start)) + 1e-9


def arm_of(bodies: str, joints: int) -> Scene:
    """An arm "arm/" with a tool; every joint may move at 1 rad/s or m/s."""
    return Scene.from_mjcf(
        f'<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>',
        robot="arm/",
        tool="arm/tool",
        velocity=[1.0] * joints,
        acceleration=[1.0] * joints,
    )


def test_bounds_of_two_slides_and_a_hinge_by_hand():
    """A slide moves the tool by its own displacement; the hinge by .25 m per radian, and turns it by the same angle."""
    scene = arm_of(
        """
          <body name="arm/x"><joint name="arm/x" type="slide" axis="1 0 0" range="-2 2"/><geom size=".02" mass="1"/>
            <body name="arm/y"><joint name="arm/y" type="slide" axis="0 1 0" range="-2 2"/><geom size=".02" mass="1"/>
              <body name="arm/turn"><joint name="arm/turn" axis="0 0 1" range="-3 3"/>
                <geom size=".02" mass="1" pos="0 0 .2"/><site name="arm/tool" pos=".25 0 0"/></body></body></body>
        """,
        joints=3,
    )
    objective, start = Objective().bind(scene), np.zeros(3)
    far = PoseGoal.at([1.25, 0.0, 0.0], position_tolerance=0.1)
    assert lower_bound(start, far, objective) == pytest.approx(0.9 / np.sqrt(1.0 + 1.0 + 0.25**2), rel=1e-5)
    turned = PoseGoal.at([0.25, 0.0, 0.0], [np.cos(0.6), 0.0, 0.0, np.sin(0.6)], orientation_tolerance=0.05)
    assert lower_bound(start, turned, objective) == pytest.approx(1.2 - 0.05, rel=1e-5)


def test_bounds_of_two_hinges_by_hand():
    """The first joint moves the tool by .55 m per radian, the second by .25 m; both turn it."""
    scene = arm_of(
        """
          <body name="arm/a"><joint name="arm/a" axis="0 0 1" range="-3 3"/><geom size=".02" mass="1"/>
            <body name="arm/b" pos=".3 0 0"><joint name="arm/b" axis="0 0 1" range="-3 3"/>
              <geom size=".02" mass="1" pos="0 0 .2"/><site name="arm/tool" pos=".25 0 0"/></body></body>
        """,
        joints=2,
    )
    objective, start = Objective().bind(scene), np.zeros(2)
    far = PoseGoal.at([-0.45, 0.0, 0.0], position_tolerance=0.1)
    assert lower_bound(start, far, objective) == pytest.approx(0.9 / np.hypot(0.55, 0.25), rel=1e-5)
    turned = PoseGoal.at([0.55, 0.0, 0.0], [np.cos(0.6), 0.0, 0.0, np.sin(0.6)], orientation_tolerance=0.05)
    assert lower_bound(start, turned, objective) == pytest.approx(1.15 / np.sqrt(2.0), rel=1e-5)


def test_a_pose_far_away_has_a_bound_above_zero(tabletop: Scene):
    X = compile_scene(tabletop).kernels.tool_pose(tabletop.keyframes["right"])
    X[0, 3] += 0.3
    bound = lower_bound(tabletop.keyframes["right"], PoseGoal(X), Objective().bind(tabletop))
    assert bound is not None and bound > 0.1


def test_a_straight_path_without_weight_has_no_gap(tabletop: Scene):
    q = np.stack([tabletop.keyframes["right"], tabletop.keyframes["near"]])
    found = certify(q, tabletop, Objective(w=0.0))
    assert found.gap == pytest.approx(0.0, abs=1e-9)
    assert found.lower_bound == pytest.approx(float(np.linalg.norm(q[1] - q[0])))
    nearer = certify(q, tabletop, Objective(w=0.0), goal=np.stack([q[1], 0.5 * (q[0] + q[1])]))
    assert nearer.gap == pytest.approx(1.0)


def test_no_gap_is_claimed_where_no_bound_is_known(tabletop: Scene):
    q = np.stack([tabletop.keyframes["right"], tabletop.keyframes["near"]])
    other_motion = certify(q, tabletop, Objective(motion=Field(constant=1.0)))
    assert other_motion.lower_bound is None and other_motion.gap is None
    round_trip = certify(np.concatenate([q, q[:1]]), tabletop)
    assert round_trip.lower_bound == 0.0 and round_trip.gap is None


def test_a_gap_is_reported_only_without_impact(tabletop: Scene):
    q = np.stack([tabletop.keyframes["right"], tabletop.keyframes["near"]])
    weighed = certify(q, tabletop, Objective(w=0.1))
    assert weighed.gap is None and weighed.lower_bound == certify(q, tabletop, Objective(w=0.0)).lower_bound


@pytest.mark.parametrize("w", [0.0, 1.0])
def test_results_are_certified_along_the_executed_motion(tabletop: Scene, w: float):
    task = load_scene("tabletop").tasks["green_to_blue"]
    solved = plan(task.start, task.goal, tabletop, w=w, iterations=500, seed=1)
    found = certify(solved, tabletop)
    assert found.clear and found.first_uncertified is None
    assert solved.trajectory is not None and solved.path is not None
    dense = compile_scene(tabletop).kernels.clearance(solved.trajectory.sample(1e-3).q)
    assert 0.0 < found.clearance <= float(dense.min())
    straight = float(np.linalg.norm(np.diff(solved.path.q[[0, -1]], axis=0)))
    assert found.lower_bound == pytest.approx(straight)
    assert found.gap == (pytest.approx(solved.cost.motion / straight - 1.0) if w == 0.0 else None)


def test_results_without_a_trajectory_are_refused(tabletop: Scene):
    refused = plan("right", np.full(len(tabletop.joints), 50.0), tabletop)
    assert refused.status is PlanStatus.INVALID_GOAL
    with pytest.raises(SettingError, match="trajectory"):
        certify(refused, tabletop)


def test_motions_of_another_robot_are_refused(tabletop: Scene):
    with pytest.raises(ShapeError):
        certify(np.zeros((3, 2)), tabletop)
    with pytest.raises(ShapeError):
        certify(np.zeros((3, 7)), tabletop, goal=np.zeros(3))


def test_a_fresh_certificate_promises_nothing():
    fresh = Certificate()
    assert not fresh.clear and fresh.lower_bound is None and fresh.gap is None

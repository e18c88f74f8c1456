"""Certificates: never better than the truth by dense sampling, exact where the truth is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan import documents
from graceful_plan.analysis.certificate import certify, exposure_bound, lower_bound
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import Objective, SceneObjective
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import Path
from graceful_plan.plan import plan
from graceful_plan.result import Certificate, PlanResult, PlanStatus
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.retiming import retime

Array = np.ndarray


@pytest.fixture(scope="module")
def tabletop() -> Scene:
    return load_scene("tabletop").tasks["green_to_blue"].scene


@pytest.fixture(scope="module")
def solved(tabletop: Scene) -> PlanResult:
    task = load_scene("tabletop").tasks["green_to_blue"]
    result = plan(task.start, task.goal, tabletop, w=1.0, iterations=3000, seed=1)
    assert result.status is PlanStatus.SOLVED
    return result


@dataclass(frozen=True)
class Field(Cost):
    """Constant, plus a slope along the first joint, plus a bump of some width around its zero."""

    constant: float = 0.0
    slope: float = 0.0
    bump: float = 0.0

    def state(self, batch: StateBatch) -> Array:
        x = batch.q[:, 0]
        return self.constant + self.slope * (x + 3.0) + self.bump * np.exp(-0.5 * (x / 0.05) ** 2)


def _random_path(scene: Scene, seed: int) -> Path:
    rng = np.random.default_rng(seed)
    ends = np.stack([scene.keyframes[name] for name in ("right", "left", "far", "near")])
    return Path(rng.permutation(ends)[:3] + rng.normal(size=(3, ends.shape[1])) * 0.2)


def _dense_exposure(motion: Path, objective: SceneObjective) -> float:
    fine = motion.resampled(0.0005).q
    return float(objective.edges(fine[:-1], fine[1:])[:, 1].sum())


@pytest.mark.parametrize("model", ["footprint", "aabb"])
@pytest.mark.parametrize("seed", range(5))
def test_the_exposure_between_samples_is_within_its_bound(tabletop: Scene, model: str, seed: int):
    objective = Objective(impact=ImpactCost(model=model)).bind(tabletop)
    path = _random_path(tabletop, seed)
    bound, dense = exposure_bound(path, objective), _dense_exposure(path, objective)
    # The fine edges go at the same two paces by turns: a little noise of the sum over them.
    assert dense * (1.0 - 1e-3) <= bound <= 1.15 * dense + 1e-6


@given(constant=st.floats(0.0, 5.0), slope=st.floats(0.0, 5.0))
@settings(max_examples=10, deadline=None)
def test_impact_without_curvature_is_bounded_closely(tabletop: Scene, constant: float, slope: float):
    objective = Objective(impact=Field(constant=constant, slope=slope)).bind(tabletop)
    q = np.zeros((2, len(tabletop.joints)))
    q[:, 0] = -1.0, 1.0
    exact = 2.0 * (constant + 3.0 * slope)
    assert exact * (1.0 - 1e-9) <= exposure_bound(Path(q), objective) <= exact + 0.01 * slope + 1e-9


def test_a_bump_between_vertices_is_seen(tabletop: Scene):
    objective = Objective(impact=Field(bump=10.0)).bind(tabletop)
    q = np.zeros((2, len(tabletop.joints)))
    q[:, 0] = -1.0, 1.0
    exact = 10.0 * 0.05 * np.sqrt(2.0 * np.pi)
    assert exact <= exposure_bound(Path(q), objective) <= 1.1 * exact


def test_exposure_in_time_and_over_waypoints(tabletop: Scene):
    path = _random_path(tabletop, 7)
    trajectory = retime(path, tabletop.limits, tabletop.joints)
    in_time = Objective(exposure="time").bind(tabletop)
    dense = in_time.breakdown(trajectory.sample(trajectory.duration / 20_000)).impact
    assert dense <= exposure_bound(trajectory, in_time) <= 1.1 * dense
    on_path = exposure_bound(path, in_time)
    assert in_time.breakdown(path.resampled(0.002)).impact * (1.0 - 1e-3) <= on_path
    waypoints = Objective(exposure="waypoints").bind(tabletop)
    assert exposure_bound(path, waypoints) == waypoints.breakdown(path).impact


def test_motions_that_stand_still_expose_to_nothing(tabletop: Scene):
    objective = Objective().bind(tabletop)
    q = tabletop.keyframes["right"]
    assert exposure_bound(Path(q[None]), objective) == 0.0
    assert exposure_bound(Path(np.stack([q, q])), objective) == 0.0


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_no_way_to_a_pose_is_shorter_than_the_lower_bound(tabletop: Scene, seed: int):
    rng = np.random.default_rng(seed)
    lower, upper = tabletop.limits.position.T
    start, end = rng.uniform(lower, upper, size=(2, len(lower)))
    end = start + rng.uniform(0.0, 1.0) * (end - start)
    objective = Objective().bind(tabletop)
    pose = PoseGoal(compile_scene(tabletop).kernels.tool_pose(end))
    bound = lower_bound(start, pose, objective)
    assert bound is not None and 0.0 <= bound <= float(np.linalg.norm(end - start)) + 1e-9


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


def test_solved_problems_have_a_certificate(tabletop: Scene, solved: PlanResult):
    found = solved.certificate
    assert found is not None and found.clear and found.first_uncertified is None
    assert solved.trajectory is not None and solved.path is not None
    dense = compile_scene(tabletop).kernels.clearance(solved.trajectory.sample(1e-3).q)
    assert 0.0 < found.clearance <= float(dense.min())
    assert found.gap == pytest.approx(
        solved.cost.total / float(np.linalg.norm(np.diff(solved.path.q[[0, -1]], axis=0))) - 1
    )
    assert found.exposure_bound >= _dense_exposure(solved.path, Objective().bind(tabletop))
    assert found == certify(solved, tabletop, goal=solved.path.q[-1])
    assert "certificate_time" in solved.stats


@dataclass(frozen=True)
class Trapped(Cost):
    """Is not a number in a place so small that only dense samples meet it."""

    place: float

    def state(self, batch: StateBatch) -> Array:
        return np.where(np.abs(batch.q[:, 0] - self.place) < 0.003, np.nan, 0.0)


def test_a_cost_that_is_not_finite_between_samples_is_a_status(tabletop: Scene):
    start, goal = tabletop.keyframes["right"], tabletop.keyframes["near"]
    seen = set()
    for share in np.linspace(0.3, 0.7, 12):
        place = float(start[0] + share * (goal[0] - start[0]))
        seen.add(plan(start, goal, tabletop, objective=Objective(w=0.0, impact=Trapped(place)), iterations=50).status)
    assert seen <= {PlanStatus.NONFINITE, PlanStatus.SOLVED} and PlanStatus.NONFINITE in seen


def test_others_have_none(tabletop: Scene):
    refused = plan("right", np.full(len(tabletop.joints), 50.0), tabletop)
    assert refused.status is PlanStatus.INVALID_GOAL and refused.certificate is None
    with pytest.raises(SettingError, match=r"a result with a trajectory"):
        certify(refused, tabletop)


def test_motions_of_another_robot_are_refused(tabletop: Scene):
    with pytest.raises(ShapeError):
        certify(np.zeros((3, 2)), tabletop)
    with pytest.raises(ShapeError):
        certify(np.zeros((3, 7)), tabletop, goal=np.zeros(3))


def test_a_fresh_certificate_promises_nothing():
    fresh = Certificate()
    assert not fresh.clear and fresh.exposure_bound == np.inf and fresh.gap is None


def test_documents_hold_it(solved: PlanResult):
    document = documents.result_document(solved)["certificate"]
    assert solved.certificate is not None
    assert document["clearance"] == solved.certificate.clearance and document["uncertified"] == ()
    assert documents.result_document(PlanResult(status=PlanStatus.TIMEOUT))["certificate"] is None

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan import CostBreakdown, ParetoFront, Path, PlanStatus, Trajectory, Verdict
from graceful_plan.exceptions import FormatError, SettingError
from graceful_plan.planners.roadmaps.graph import non_dominated
from graceful_plan.result import Check
from graceful_plan.tuning.fronts import ChoiceStatus, ParetoPoint
from graceful_plan.tuning.points import dominated_area, front_of, hull_weights

numbers = st.floats(0.0, 10.0, allow_nan=False).map(lambda x: round(x, 3))
clouds = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=12).map(np.array)


def point(motion: float, impact: float) -> ParetoPoint:
    q = np.array([[0.0, 0.0], [motion, 1.0]])
    trajectory = Trajectory(np.array([0.0, 1.0]), q, np.zeros((2, 2)), np.zeros((2, 2)), ("a", "b"))
    cost = CostBreakdown(motion=motion, impact=impact, impact_by_entity={"vase": impact})
    verdict = Verdict(checks={"collision": Check(passed=True, worst=np.inf, detail="none")})
    return ParetoPoint(path=Path(q), trajectory=trajectory, cost=cost, verdict=verdict, made_by="weight", made_with=1.0)


def front(costs) -> ParetoFront:
    points = front_of([point(motion, impact) for motion, impact in costs])
    return ParetoFront(status=PlanStatus.SOLVED, points=points, scene="nowhere")


CONVEX = ((1.0, 8.0), (1.5, 4.0), (2.0, 2.0), (3.0, 1.0), (6.0, 0.5))
DENTED = ((1.0, 4.0), (1.9, 3.6), (3.0, 1.0))  # the middle lies above the chord of its neighbours


# --- laws -------------------------------------------------------------------------------------------------------------


@given(clouds)
def test_a_front_holds_the_points_that_none_is_better_than(costs):
    kept = non_dominated(costs)
    assert np.all(np.diff(costs[kept, 0]) > 0.0)
    for i, keeps in enumerate(np.isin(np.arange(len(costs)), kept)):
        no_worse = np.all(costs <= costs[i], axis=1)
        better = no_worse & np.any(costs < costs[i], axis=1)
        earlier_equal = np.any(np.all(costs[:i] == costs[i], axis=1))
        assert keeps == (not better.any() and not earlier_equal)


@given(clouds, st.randoms())
def test_a_front_does_not_depend_on_the_order(costs, random):
    shuffled = costs.tolist()
    random.shuffle(shuffled)
    np.testing.assert_array_equal(front(costs).costs, front(shuffled).costs)


@given(clouds, clouds)
def test_hypervolume_grows_with_points_and_shrinks_with_none(some, more):
    reference = np.array([11.0, 11.0])
    before = dominated_area(some, reference)
    after = dominated_area(np.concatenate([some, more]), reference)
    assert after >= before - 1e-9
    assert after >= dominated_area(more, reference) - 1e-9
    assert after <= before + dominated_area(more, reference) + 1e-9


@given(clouds)
def test_hypervolume_is_the_area_of_cells_that_are_dominated(costs):
    """Oracle: a grid through all coordinates."""
    reference = np.array([11.0, 11.0])
    x, y = (np.unique(np.append(costs[:, k], 11.0)) for k in (0, 1))
    area = sum(
        (x[i + 1] - x[i]) * (y[j + 1] - y[j])
        for i in range(len(x) - 1)
        for j in range(len(y) - 1)
        if np.any(np.all(costs <= [x[i], y[j]], axis=1))
    )
    assert dominated_area(costs, reference) == pytest.approx(area, abs=1e-9)


@given(clouds, st.floats(0.0, 100.0))
def test_points_are_best_for_their_weights(costs, w):
    found = front(costs)
    totals = found.costs @ np.array([1.0, w])
    for p, total in zip(found.points, totals, strict=True):
        if p.weights is not None and p.weights[0] <= w <= p.weights[1]:
            assert total == pytest.approx(totals.min(), abs=1e-6)
    assert any(p.weights is not None and p.weights[0] <= w <= p.weights[1] for p in found.points)


@given(clouds)
def test_weights_are_intervals_from_nothing_to_infinity(costs):
    intervals = [weights for weights in (p.weights for p in front(costs).points) if weights is not None]
    assert intervals[0][0] == 0.0 and intervals[-1][1] == np.inf
    assert [high for _, high in intervals[:-1]] == [low for low, _ in intervals[1:]]


# --- known values -----------------------------------------------------------------------------------------------------


def test_known_hypervolume():
    found = front([(1.0, 3.0), (2.0, 1.0)])
    assert found.hypervolume([4.0, 4.0]) == pytest.approx((3.0 * 1.0 + 2.0 * 2.0) / 16.0)
    assert found.hypervolume() == pytest.approx((1.2 * 0.3 + 0.2 * 2.0) / (2.2 * 3.3))
    assert found.hypervolume([1.0, 1.0]) == 0.0
    assert ParetoFront(status=PlanStatus.TIMEOUT).hypervolume() == 0.0


def test_knee_of_a_known_front():
    assert front(CONVEX).knee.motion == 2.0  # (0.2, 0.2) on axes scaled to [0, 1]; the other sums are >= 0.567
    assert front([(1.0, 2.0)]).knee.motion == 1.0
    assert front([(1.0, 2.0), (2.0, 1.0)]).knee.motion == 1.0
    assert ParetoFront(status=PlanStatus.TIMEOUT).knee is None


def test_weights_of_a_known_front():
    assert hull_weights(np.array(CONVEX)) == [(0.0, 0.125), (0.125, 0.25), (0.25, 1.0), (1.0, 6.0), (6.0, np.inf)]
    assert hull_weights(np.array(DENTED))[1] is None


# --- choices ----------------------------------------------------------------------------------------------------------


def test_choice_by_a_target_is_the_shortest_that_meets_it():
    choice = front(CONVEX).choose(target_impact=2.5)
    assert choice.status is ChoiceStatus.MET
    assert (choice.point.motion, choice.w) == (2.0, 0.25)
    assert front(CONVEX).smallest_w(2.5) == 0.25
    assert front(CONVEX).smallest_w(100.0) == 0.0


def test_choice_by_a_detour_is_the_least_impact_within():
    choice = front(CONVEX).choose(max_detour=1.0)
    assert (choice.status, choice.point.motion, choice.w) == (ChoiceStatus.MET, 2.0, 0.25)
    assert front(CONVEX).choose(max_detour=0.0).point.motion == 1.0


def test_a_choice_in_a_dent_names_the_weight_beyond():
    choice = front(DENTED).choose(target_impact=3.7)
    assert choice.point.motion == 1.9
    assert choice.w == pytest.approx(2.0 / 3.0)
    assert "motion 3, impact 1" in choice.detail
    within = front(DENTED).choose(target_impact=3.7, max_detour=1.0)
    assert (within.status, within.point.motion, within.w) == (ChoiceStatus.MET, 1.9, None)
    assert "no weight" in within.detail


def test_choice_without_demands_is_the_knee():
    found = front(CONVEX)
    assert found.choose().point is found.knee


def test_unreachable_targets_are_refused():
    choice = front(CONVEX).choose(target_impact=0.1)
    assert (choice.status, choice.w, choice.point.impact) == (ChoiceStatus.UNREACHABLE, None, 0.5)
    both = front(CONVEX).choose(target_impact=1.5, max_detour=1.0)
    assert (both.status, both.point.impact) == (ChoiceStatus.UNREACHABLE, 2.0)
    assert "detour of 200 %" in both.detail
    empty = ParetoFront(status=PlanStatus.INVALID_GOAL, detail="goal: in the wall").choose(target_impact=1.0)
    assert (empty.status, empty.point, empty.w) == (ChoiceStatus.NO_FRONT, None, None)
    assert "in the wall" in empty.detail


@pytest.mark.parametrize("demand", [{"target_impact": -1.0}, {"target_impact": np.nan}, {"max_detour": np.inf}])
def test_invalid_demands_are_refused(demand):
    with pytest.raises(SettingError, match=next(iter(demand))):
        front(CONVEX).choose(**demand)


def test_invalid_references_are_refused():
    with pytest.raises(SettingError, match="reference"):
        front(CONVEX).hypervolume([0.0, 1.0])


# --- files ------------------------------------------------------------------------------------------------------------


def test_front_comes_back_from_its_file(tmp_path):
    found = dataclasses.replace(front(DENTED), detail="a dent", stats={"total_time": 1.5})
    found.save(tmp_path / "front.json")
    again = ParetoFront.load(tmp_path / "front.json")
    assert (again.status, again.detail, again.scene) == (found.status, found.detail, found.scene)
    assert again.stats == found.stats
    assert again.to_json() == found.to_json()
    assert [p.weights for p in again.points] == [p.weights for p in found.points]
    assert again.points[0].verdict == found.points[0].verdict
    np.testing.assert_array_equal(again.points[1].path.q, found.points[1].path.q)
    empty = ParetoFront(status=PlanStatus.INVALID_START, detail="in the wall")
    assert ParetoFront.load(empty.to_json()).status is PlanStatus.INVALID_START


def damaged(change):
    document = json.loads(front(CONVEX).to_json())
    change(document)
    return json.dumps(document)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("scene"), "scene"),
        (lambda d: d.update(more=1), "more"),
        (lambda d: d.update(version=2), "version is 2"),
        (lambda d: d.update(schema="other"), "schema"),
        (lambda d: d.update(status="FINE"), "FINE"),
        (lambda d: d.update(points={}), "points must be a list"),
        (lambda d: d.update(points=[]), "not a front"),
        (lambda d: d.update(stats={"seconds": "long"}), "stats.seconds"),
        (lambda d: d["points"].append(d["points"][0]), "not a front"),
        (lambda d: d["points"][0].pop("path"), r"points\[0\]"),
        (lambda d: d["points"].insert(0, 7), "an object is expected"),
        (lambda d: d["points"][0]["cost"].update(impact=-1.0), r"points\[0\].cost.impact"),
        (lambda d: d["points"][0]["cost"].update(motion=True), r"points\[0\].cost.motion"),
        (lambda d: d["points"][0]["cost"].update(motion=None), r"points\[0\].cost.motion"),
        (lambda d: d["points"][0]["verdict"].update(checks={}), "verified points only"),
        (lambda d: d["points"][0]["verdict"]["checks"]["collision"].update(passed=False), "verified points only"),
        (lambda d: d["points"][0]["verdict"]["checks"]["collision"].update(passed=1), "true or false"),
        (lambda d: d["points"][0].update(made_by=3), "must be a text"),
    ],
)
def test_damaged_files_are_refused(change, message):
    with pytest.raises(FormatError, match=message):
        ParetoFront.load(damaged(change))


def test_invalid_files_are_refused(tmp_path):
    with pytest.raises(FormatError, match="cannot be read"):
        ParetoFront.load(tmp_path / "nowhere.json")
    (tmp_path / "cut.json").write_text(front(CONVEX).to_json()[:-40])
    with pytest.raises(FormatError, match="not JSON"):
        ParetoFront.load(tmp_path / "cut.json")
    with pytest.raises(FormatError, match="object"):
        (tmp_path / "list.json").write_text("[]")
        ParetoFront.load(tmp_path / "list.json")

"""From paths to a front of smooth motions: the weights of the descents, and the entries of the archive."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import Objective, SceneObjective, search_paces
from graceful_plan.planners import Auto
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.roadmaps.graph import non_dominated
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.search import search
from graceful_plan.query.endpoints.endpoints import find_endpoints
from graceful_plan.query.request import Request
from graceful_plan.tuning.archive import Archive, Candidate
from graceful_plan.tuning.judging import FrontMotion, FrontQuery, Judging
from graceful_plan.tuning.motion_front import MotionFront, optimal_weights
from graceful_plan.tuning.points import hull_weights

numbers = st.floats(0.01, 10.0).map(lambda x: round(x, 3))
clouds = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=9).map(np.array)
POINTS = 4


@given(clouds)
def test_weights_lead_to_their_points_where_the_front_is_convex(costs):
    front = costs[non_dominated(costs)]
    weights = optimal_weights(front, 1e6)
    assert len(weights) == len(front) and weights[0] == 0.0
    assert len(front) == 1 or weights[-1] == 1e6
    intervals = hull_weights(front)
    if all(interval is not None for interval in intervals):
        for w, (low, high) in zip(weights, intervals, strict=True):
            assert low * (1.0 - 1e-9) <= w <= high * (1.0 + 1e-9)


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop_l1").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def asked(task):
    """The request for a front, the search problem, and a few paths."""
    rng = np.random.default_rng(0)
    held = SceneConstraints(task.scene, ())
    ends = find_endpoints(task.start, task.goal, held, rng)
    objective = Objective().bind(task.scene, search_paces())
    query = FrontQuery(ends=ends, request=Request(planner=Auto(), objective=objective, constraints=held))
    goals = np.stack([arrival.q[0] for arrival in ends.arrivals])
    problem = SceneProblem(kernels=ends.constraints.kernels, start=ends.departure.q[-1], goals=goals, margin=0.002)
    paths: Archive[Candidate] = Archive()
    for w in (0.0, 1.0):
        for path in search(Auto(), problem, query.at(w), Budget(iterations=200), rng, kept=100).paths:
            paths.offer(Candidate.of(path, query.at(w), "weight", w))
    assert len(paths) > 1
    return query, problem, paths


def filled(asked, budget=None, gaps=True) -> tuple[Archive[FrontMotion], list[str]]:
    query, problem, paths = asked
    archive: Archive[FrontMotion] = Archive()
    front = MotionFront(query, problem, archive, POINTS)
    stages = list(front.fill(paths, budget or Budget(iterations=1), np.random.default_rng(0), gaps=gaps))
    return archive, stages


def test_motions_descend_from_paths_then_in_gaps_and_finely(asked):
    archive, stages = filled(asked)
    assert stages[:2] == ["descend"] * 2 and stages.count("gaps") == POINTS / 2 and "polish" in stages
    assert len(archive) > 1
    smooth = [one for one in archive.candidates if one.made_by == "descent"]
    assert len(smooth) >= len(archive) - 1
    for one in smooth:
        speed = np.linalg.norm(one.motion.trajectory.qd, axis=1)
        assert np.all(speed[1:-1] > 0.0), "a smooth motion never stops in between"
        cost = gp.evaluate(one.motion.trajectory, asked[0].request.objective.scene)
        assert one.cost.tolist() == [pytest.approx(cost.motion), pytest.approx(cost.impact)]


def test_motions_are_better_than_the_paths_they_came_from_with_corners_cut(asked):
    query, _, paths = asked
    motions = filled(asked)[0].costs
    along = [query.point_along(candidate) for candidate in paths.chosen(POINTS)]
    for w in (0.1, 1.0):
        weight = np.array([1.0, w])
        assert (motions @ weight).min() <= min(p.motion + w * p.impact for p in along if p is not None)


def test_without_gaps_it_ends_once_the_motions_have_descended(asked):
    archive, stages = filled(asked, gaps=False)
    assert set(stages) == {"descend", "polish"}
    assert len(archive)


def test_without_time_or_paths_there_are_no_motions(asked):
    query, problem, _ = asked
    archive, stages = filled((query, problem, Archive()))
    assert not stages and not len(archive)
    archive, stages = filled(asked, Budget(time_limit=0.0))
    assert len(stages) <= 1, "one motion along a path, so that there is any"
    assert all(one.made_by != "descent" for one in archive.candidates)


def test_paths_that_cannot_descend_are_timed_with_their_corners_cut(asked, monkeypatch):
    monkeypatch.setattr("graceful_plan.tuning.motion_front.motion_descents", lambda *arguments: None)
    archive, _ = filled(asked)
    assert len(archive) and all(one.made_by == "weight" for one in archive.candidates)


def candidate(motion: float, impact: float) -> Candidate:
    return Candidate(q=np.zeros((2, 1)), edges=np.array([[motion, impact]]), made_by="weight", made_with=1.0)


def test_refused_motions_are_replaced(asked):
    archive: Archive[Candidate] = Archive()
    for motion, impact in ((1.0, 5.0), (2.0, 3.0), (3.0, 2.0), (4.0, 1.0)):
        archive.offer(candidate(motion, impact))
    refused = archive.candidates[2]
    point = asked[0].point_along(asked[2].candidates[0])
    judging = Judging(archive, lambda one: None if one is refused else point, 4, 1.0)
    assert judging.time_first() and not judging.time_first()
    assert len(judging.front(Budget())) == 3
    assert judging.refused == 1 and refused not in archive.candidates


def test_costs_without_descents_have_fronts_of_paths(task, monkeypatch):
    monkeypatch.setattr(SceneObjective, "descended", lambda objective: None)  # as with moving entities
    paper = gp.Objective(exposure="length", impact=gp.ImpactCost(model="box_overlap"))
    front = gp.pareto(task.start, task.goal, task.scene, iterations=60, points=2, objective=paper)
    assert front.status is gp.PlanStatus.SOLVED
    assert all(point.made_by != "descent" for point in front.points)

"""OMPL's planners over poses: their paths roll, are free, improve, and repeat for a seed."""

from dataclasses import replace

import numpy as np
import pytest
from test_drive_lattice import asked, rolls

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.planners import DRIVING, PoseSpace, ReedsSheppPRM, ReedsSheppRRT, ReedsSheppRRTStar
from graceful_plan.planners.planner import Budget, path_total
from hall import BASE, hall
from sizes import first_quick

SCENE = hall()
PLANNERS = (ReedsSheppRRT, ReedsSheppRRTStar, ReedsSheppPRM)


def found(planner, scene=SCENE, iterations=120, w=0.0):
    problem, objective = asked(scene, [-4.0, 0.0, 0.0], [[4.0, 0.0, 0.0]], w)
    paths = list(planner.solve(problem, objective, Budget(iterations=iterations), np.random.default_rng(1)))
    return paths, problem, objective


@pytest.mark.parametrize("planner", first_quick(PLANNERS), ids=lambda planner: planner.name)
def test_paths_roll_are_free_and_improve(planner):
    paths, problem, objective = found(planner())
    totals = [path_total(objective, path) for path in paths]
    assert paths and totals == sorted(totals, reverse=True)
    for path in paths:
        assert rolls(path) and problem.edges_free(path.q[:-1], path.q[1:]).all()
        np.testing.assert_allclose(path.q[[0, -1]], [[-4, 0, 0], [4, 0, 0]], atol=1e-9)
    again = found(planner())[0]
    assert [path.q.tolist() for path in again] == [path.q.tolist() for path in paths]


def test_no_curve_is_tighter_than_the_radius():
    (path, *_), _, _ = found(ReedsSheppRRT(poses=PoseSpace(radius=0.8)))
    way = np.linalg.norm(np.diff(path.q[:, :2], axis=0), axis=1)
    turned = np.abs(np.diff(path.q[:, 2]))
    assert turned.sum() <= way.sum() / 0.8 + 1e-6


@pytest.mark.long
def test_through_plan_with_result_and_verdict():
    result = gp.plan("west", "east", SCENE, w=0.0, planner="reeds_shepp_rrt_star", iterations=150)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["rolling"].passed
    assert result.trace[-1].total == pytest.approx(result.cost.total)


def test_unsuitable_robots_are_refused():
    forward = hall(replace(BASE, reverse=False))
    for planner in PLANNERS:
        assert DRIVING[planner.name] is planner
        with pytest.raises(SettingError, match="only drive forward"):
            found(planner(), forward)
    with pytest.raises(SettingError, match="radius"):
        PoseSpace(radius=0.0)
    with pytest.raises(SettingError, match="no DiffDrive"):
        gp.plan("home", "home", gp.load_scene("tabletop"), planner="reeds_shepp_rrt")

"""Homotopy classes on the floor, routes along them, and initial postures."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.mobile.motions.carry_postures import carry_postures, with_posture
from graceful_plan.mobile.motions.floor_ways import ways
from graceful_plan.mobile.motions.legs import RollingLeg, along_ways, routes
from graceful_plan.planners.scene_problem import SceneProblem
from hall import hall

WEST, EAST = np.array([-4.0, 0.0, 0.0]), np.array([4.0, 0.0, 0.0])


def test_routes_lead_around_both_sides_of_an_obstacle():
    found = list(ways(hall(), WEST, EAST))
    sides = {bool(np.interp(0.0, way[:, 0], way[:, 1]) > 0.0) for way in found}
    assert sides == {True, False}
    for way in found:
        np.testing.assert_array_equal(way[[0, -1]], [WEST[:2], EAST[:2]])
    lengths = [np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in found]
    assert lengths[0] == min(lengths)


def test_there_is_no_way_through_walls_nor_to_where_it_is():
    closed = hall(walls='<body name="wall" pos="0 0 .5"><geom type="box" size=".05 12 .5"/></body>')
    assert not list(ways(closed, WEST, EAST))
    assert not list(ways(hall(), WEST, WEST + [0.0, 0.0, 1.0]))


@pytest.mark.parametrize(("yaw", "forward"), [(0.0, True), (np.pi, False)])
def test_the_gear_that_needs_no_turns_comes_first(yaw, forward):
    start, goal = (np.array([*end[:2], yaw]) for end in (WEST, EAST))
    (first,) = next(along_ways([np.stack([WEST[:2], EAST[:2]])], start, goal, reverse=True))
    assert isinstance(first, RollingLeg) and first.forward is forward
    assert not (first.turns_before or first.turns_after)


def test_a_base_that_does_not_reverse_has_no_route_backward():
    found = along_ways([np.stack([WEST[:2], EAST[:2]])], WEST + [0, 0, 3.0], EAST, reverse=False)
    assert all(route[0].forward for route in found)


def test_turns_and_moves_of_the_arm_are_made_on_the_way_or_at_rests():
    q = np.array([[0, 0, 0, 0.0], [1, 0, 0, 0.0], [1, 0, 1.57, 0.0], [1, 0, 1.57, 0.8]])
    found = list(routes(gp.Path(q)))
    assert {len(route) for route in found} == {1, 2}
    alone = [route[0] for route in found if len(route) == 1]
    assert {leg.turns_after for leg in alone} == {True, False}
    for leg in alone:
        assert leg.q[0, 3] == 0.0 and leg.q[-1, 3] == 0.8 and leg.q[-1, 2] == pytest.approx(1.57)


def test_postures_in_which_less_would_be_harmed_come_first():
    scene = gp.load_scene("hallway").tasks["carry_bottle"].scene.without_moving()
    objective = gp.Objective(w=0.3).bind(scene)
    start, goal = (scene.keyframes[name] for name in ("ready", "far_end"))
    problem = SceneProblem(kernels=objective.kernels, start=start, goals=goal[None], margin=0.002)
    motion = gp.retime(gp.Path(np.stack([start, goal])), scene.limits, scene.joints)
    found = carry_postures(motion, problem, objective, np.random.default_rng(0))
    assert 1 <= len(found) <= 3
    q = motion.at(np.linspace(2.0, motion.duration - 2.0, 8)).q

    def harm(arm):
        changed = q.copy()
        changed[:, 3:] = arm
        return objective.approximate_states(changed, np.zeros_like(q)).mean()

    assert harm(found[0]) < 0.8 * harm(start[3:])
    controls = np.column_stack([np.tile(start, (12, 1))[:, [0, 1, *range(3, 11)]], np.zeros(12)])
    moved = with_posture(controls, found[0])
    np.testing.assert_array_equal(moved[[0, -1]], controls[[0, -1]])
    np.testing.assert_allclose(moved[5, 2:-1], found[0], atol=1e-12)

"""Goal regions: boxes around a pose, and free axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import pose_error

_SIZES = st.tuples(*[st.sampled_from([0.0, 0.01, 0.3])] * 3)
_TURNS = st.tuples(*[st.sampled_from([0.0, 0.5, np.pi])] * 3)
CENTRE = gp.PoseGoal.at([0.5, 0.1, 0.4], [0.1, 0.9, 0.2, -0.3], position_tolerance=0.002)


@given(_SIZES, _TURNS, st.integers(1, 40))
def test_goals_are_in_the_region_and_the_first_is_its_middle(
    size: tuple[float, ...], turns: tuple[float, ...], count: int
) -> None:
    goals = CENTRE.region(list(size), list(turns), count)
    assert len(goals) == count
    np.testing.assert_allclose(goals[0].X_WT, CENTRE.X_WT, atol=1e-12)
    for goal in goals:
        off = CENTRE.X_WT[:3, :3].T @ (goal.X_WT[:3, 3] - CENTRE.X_WT[:3, 3])
        assert (np.abs(off) <= np.array(size) + 1e-9).all()
        assert pose_error(CENTRE, goal.X_WT)[1] <= sum(turns) + 1e-9
        assert goal.position_tolerance == 0.002


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turn_keeps_its_axis_and_goes_all_the_way_round(axis: int) -> None:
    goals = CENTRE.region(turns=np.pi * np.eye(3)[axis], count=32)
    angles = []
    for goal in goals:
        R = CENTRE.X_WT[:3, :3].T @ goal.X_WT[:3, :3]
        np.testing.assert_allclose(R[:, axis], np.eye(3)[axis], atol=1e-9)
        other = (axis + 1) % 3, (axis + 2) % 3
        angles.append(np.arctan2(R[other[1], other[0]], R[other[0], other[0]]))
    gaps = np.diff(np.sort([*angles, min(angles) + 2.0 * np.pi]))
    assert gaps.max() < 3.0 * 2.0 * np.pi / 32


def test_a_box_is_filled_evenly() -> None:
    goals = CENTRE.region([0.2, 0.1, 0.0], count=64)
    off = np.array([CENTRE.X_WT[:3, :3].T @ (goal.X_WT[:3, 3] - CENTRE.X_WT[:3, 3]) for goal in goals])
    quarters = np.unique((off[:, :2] > 0.0) @ [1, 2], return_counts=True)[1]
    assert len(quarters) == 4 and quarters.min() >= 12
    assert np.abs(off[:, 2]).max() < 1e-12 and np.abs(off[:, 0]).max() > 0.18


def test_regions_are_checked() -> None:
    for size, turns in (([-0.1, 0, 0], [0, 0, 0]), ([0, 0, 0], [0, 4.0, 0])):
        with pytest.raises(SettingError, match="sizes"):
            CENTRE.region(size, turns)
    with pytest.raises(ShapeError, match="half_size"):
        CENTRE.region([0.1])
    with pytest.raises(SettingError, match="count = 0"):
        CENTRE.region(count=0)


@pytest.mark.long
def test_a_plan_ends_in_a_region_with_blocked_middle() -> None:
    task = gp.load_scene("tabletop").tasks["right_to_left"]
    scene = task.scene.detach()
    ready = scene.keyframes["ready"]
    centre = gp.PoseGoal.from_tool(ready, scene, translation=[0.0, 0.2, 0.0])
    blocked = scene.add_sphere("ball", 0.04, centre.X_WT[:3, 3])
    goals = centre.region([0.15, 0.15, 0.0], [0.0, 0.0, np.pi], count=16)
    result = gp.plan(ready, goals, blocked, w=0.0, time_limit=20.0, callback=lambda _: True)
    assert result.goal_index not in (None, 0)
    site = Placement(blocked).place(result.unwrap().q[-1]).site(blocked.tool)
    off = centre.X_WT[:3, :3].T @ (site.xpos - centre.X_WT[:3, 3])
    assert (np.abs(off) <= np.array([0.15, 0.15, 0.0]) + 0.0011).all()
    assert abs(site.xmat.reshape(3, 3)[:, 2] @ centre.X_WT[:3, 2] - 1.0) < 1e-3

"""Motions that descents end with: how far they stay from things."""

from __future__ import annotations

import pytest

import graceful_plan as gp
from graceful_plan.query.candidates.descents import STRAY_CLEARANCE
from sizes import first_quick


@pytest.mark.parametrize("name", first_quick(["corner_to_blue", "near_to_blue", "green_to_blue"]))
def test_a_motion_passes_things_with_room_for_what_a_robot_strays(name: str) -> None:
    task = gp.load_scene("tabletop_l3").tasks[name]
    found = gp.plan(task.start, task.goal, task.scene, w=3.0, iterations=30, seed=1)
    clearance = gp.clearance(task.scene, found.unwrap().sample(0.004).q)
    assert min(clearance[0], clearance[-1]) > 2.0 * STRAY_CLEARANCE  # there is room
    assert clearance.min() >= 0.75 * STRAY_CLEARANCE

"""Motions of bundled tasks, from which tests of moving starts and goals take their states."""

from __future__ import annotations

import pytest
from planned_tasks import planned

import graceful_plan as gp


@pytest.fixture(scope="module")
def block() -> tuple[gp.Task, gp.Trajectory]:
    return planned("tabletop", "lift_to_goal", w=0.0, iterations=40)


@pytest.fixture(scope="module")
def coffee() -> tuple[gp.Task, gp.Trajectory]:
    return planned("desk", "bring_coffee", w=0.0, speed=0.5, iterations=40)

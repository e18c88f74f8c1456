"""Bundled tasks with a planned motion."""

from __future__ import annotations

from typing import Any

import numpy as np

import graceful_plan as gp


def planned(scene: str, task: str, **settings: Any) -> tuple[gp.Task, gp.Trajectory]:
    asked = gp.load_scene(scene).tasks[task]
    return asked, gp.plan(asked.start, asked.goal, asked.scene, **settings).unwrap()


def assert_within_limits(states: gp.State, scene: gp.Scene) -> None:
    """Check positions, velocities and accelerations against the limits of the joints."""
    lower, upper = scene.limits.position.T
    assert np.all(np.abs(states.qd) <= scene.limits.velocity * (1.0 + 1e-6))
    assert np.all(np.abs(states.qdd) <= scene.limits.acceleration * (1.0 + 1e-6))
    assert np.all((states.q >= lower - 1e-6) & (states.q <= upper + 1e-6))

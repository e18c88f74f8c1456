"""Bundled tasks with a planned motion."""

from __future__ import annotations

from typing import Any

import graceful_plan as gp


def planned(scene: str, task: str, **settings: Any) -> tuple[gp.Task, gp.Trajectory]:
    asked = gp.load_scene(scene).tasks[task]
    return asked, gp.plan(asked.start, asked.goal, asked.scene, **settings).unwrap()

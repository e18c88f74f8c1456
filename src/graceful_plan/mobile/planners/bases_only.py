"""Planners for bases refuse robots that have none."""

from __future__ import annotations

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.planners.planner import BoundObjective
from graceful_plan.scene.mobile.diff_drive import DiffDrive


def of_a_base(objective: BoundObjective, planner: str) -> tuple[SceneObjective, DiffDrive]:
    """Return the objective, which knows a scene, and the base in it.

    Args:
        objective: As a planner gets it.
        planner: Its name.

    Raises:
        SettingError: If there is no scene, or its robot has no base that drives.
    """
    if isinstance(objective, SceneObjective) and objective.scene.base is not None:
        return objective, objective.scene.base
    raise SettingError("planner", planner, "a planner for arms: this robot has no DiffDrive")

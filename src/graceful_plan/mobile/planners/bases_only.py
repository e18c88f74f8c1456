"""Check that a robot has a base before a planner for bases runs."""

from __future__ import annotations

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.planners.planner import BoundObjective
from graceful_plan.scene.mobile.diff_drive import DiffDrive


def of_a_base(objective: BoundObjective, planner: str) -> tuple[SceneObjective, DiffDrive]:
    """Return the objective as a scene objective, and the base of its scene.

    Args:
        objective: Objective passed to the planner.
        planner: Name of the planner.

    Raises:
        SettingError: If there is no scene, or its robot has no base.
    """
    if isinstance(objective, SceneObjective) and objective.scene.base is not None:
        return objective, objective.scene.base
    raise SettingError("planner", planner, "a planner for arms: this robot has no DiffDrive")

"""A scene and its objective without moving entities."""

from __future__ import annotations

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene


@per_scene
def without_moving(scene: Scene) -> Scene:
    """Return the scene without moving entities, cached because compiling it takes as long as a short planning call."""
    return scene.without_moving()


def static_objective(of: SceneObjective) -> SceneObjective:
    """Return an objective in the same scene without moving entities."""
    return SceneObjective(of.objective, without_moving(of.scene), of.paces) if of.scene.moving else of

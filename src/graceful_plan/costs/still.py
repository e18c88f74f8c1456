"""A scene, and an objective in it, without moving entities."""

from __future__ import annotations

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene


@per_scene
def as_if_nobody_moved(scene: Scene) -> Scene:
    """Return a scene without those who move, the same in every call: compiling it takes as long as a short call."""
    return scene.without_moving()


def still_objective(of: SceneObjective) -> SceneObjective:
    """Return an objective in the same scene without moving entities."""
    return SceneObjective(of.objective, as_if_nobody_moved(of.scene), of.paces) if of.scene.moving else of

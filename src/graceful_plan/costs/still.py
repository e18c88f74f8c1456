"""A scene as if nobody moved."""

from __future__ import annotations

from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene


@per_scene
def as_if_nobody_moved(scene: Scene) -> Scene:
    """Return a scene without those who move, the same in every call: compiling it takes as long as a short call."""
    return scene.without_moving()

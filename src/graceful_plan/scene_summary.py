"""A scene as text for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from graceful_plan.model_parts import geom_label

if TYPE_CHECKING:
    from graceful_plan.scene import Scene


def summary(scene: Scene) -> str:
    """List what a scene is made of: robot, components, entities with severities, what may touch, tasks."""
    columns = list(scene.components)
    lines = [
        f"scene {scene.name!r}: robot {scene.robot!r}, tool {scene.tool!r}, {len(scene.joints)} planned joints",
        *([scene.notes.description] if scene.notes.description else []),
        "components:",
        *(f"  {c.name:<9} {c.component_class:<13} {_geoms(scene, c.geoms)}" for c in scene.components.values()),
        "entities (severity of " + ", ".join(columns) + "):",
        *(
            f"  {e.name:<20} {e.category:<11} " + "  ".join(f"{e.severity[c]:5g}" for c in columns)
            for e in scene.entities.values()
        ),
        *(
            f"  {name:<20} {entity.category:<11} "
            + "  ".join(f"{scene.moving_severity[name][c]:5g}" for c in columns)
            + f"  moves from {entity.t[0]:g} to {entity.t[-1]:g} s"
            for name, entity in scene.moving.items()
        ),
        "obstacles only: " + (", ".join(scene.unlabelled) or "none"),
        "may touch:",
        *(f"  {a.first} - {a.second} ({a.when})" for a in scene.allowed_contacts),
        "keyframes: " + (", ".join(scene.keyframes) or "none"),
        "tasks:",
        *(f"  {t.name:<20} {t.description}" for t in scene.tasks.values()),
    ]
    return "\n".join(lines)


def _geoms(scene: Scene, geoms: tuple[int, ...]) -> str:
    shown = [geom_label(scene.model, g) for g in geoms[:4]]
    return ", ".join(shown) + (f" and {len(geoms) - 4} more" if len(geoms) > 4 else "")

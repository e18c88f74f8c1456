"""A readable text summary of a scene."""

from __future__ import annotations

from collections.abc import Mapping

from graceful_plan.scene.contacts import unchecked_links
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.model_parts import geom_label


def summary(scene: SceneFacts, tasks: Mapping[str, str]) -> str:
    """List the parts of a scene: robot, components, entities with severities, allowed contacts, tasks."""
    columns = list(scene.components)
    lines = [
        f"scene {scene.name!r}: robot {scene.robot!r}, tool {scene.tool!r}, {len(scene.joints)} planned joints",
        *([scene.notes.description] if scene.notes.description else []),
        "components:",
        *(f"  {c.name:<9} {c.component_class:<13} {_geoms(scene, c.geoms)}" for c in scene.components.values()),
        *([] if scene.carried is None else [f"severity of the loss of {scene.carried.body}: {scene.own_severity:g}"]),
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
        *(f"  {a.first} - {a.second} ({a.when})" for a in scene.allowed_contacts if not a.reason),
        *_links(scene),
        "keyframes: " + (", ".join(scene.keyframes) or "none"),
        "tasks:",
        *(f"  {name:<20} {told}" for name, told in tasks.items()),
    ]
    return "\n".join(lines)


def _links(scene: SceneFacts) -> list[str]:
    """List the links of the robot that may touch each other, by reason."""
    count, unchecked = unchecked_links(scene.model, scene.robot_bodies, scene.collision_pairs(), scene.allowed_contacts)
    pairs = {reason: ", ".join(f"{a} - {b}" for a, b in found) for reason, found in sorted(unchecked.items())}
    return [f"links that may not touch: {count} pairs; that may:", *(f"  {k}: {told}" for k, told in pairs.items())]


def _geoms(scene: SceneFacts, geoms: tuple[int, ...]) -> str:
    shown = [geom_label(scene.model, g) for g in geoms[:4]]
    return ", ".join(shown) + (f" and {len(geoms) - 4} more" if len(geoms) > 4 else "")

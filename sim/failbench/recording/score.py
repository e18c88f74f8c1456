"""What a rollout cost, in the unit of the planner's prediction: severities of the entities that were touched."""

from __future__ import annotations

import math
from collections.abc import Callable

from failbench.recording.records import ContactEvent, Rollout
from graceful_plan import Scene
from graceful_plan.scene.harm.fragility import FragilityTable


def observed_impact(rollout: Rollout, scene: Scene) -> float:
    """Return the sum of the severities of all entities that a component touched, each once.

    Where several components touched an entity, the worst of them counts.
    """
    return math.fsum(worst_severities(rollout, scene).values())


def energy_impact(rollout: Rollout, scene: Scene, fragility: FragilityTable | None = None) -> float:
    """Return the same, with each severity times the probability of damage at the energy of the first touch.

    Args:
        rollout: What happened.
        scene: Where.
        fragility: How easily things are damaged; the shipped table by default.
    """
    table = FragilityTable.shipped() if fragility is None else fragility

    def damage(category: str, event: ContactEvent) -> float:
        return table.probability(category, event.striker, event.energy)

    return math.fsum(worst_severities(rollout, scene, damage).values())


def secondary_impact(rollout: Rollout, scene: Scene) -> float:
    """Return the sum of the severities of the entities that nothing but other entities touched.

    An entity that is knocked over counts as if it were the carried object, or the body if nothing is carried.
    """
    component = "carried" if "carried" in scene.components else "body"
    direct = {event.entity for event in rollout.events if not event.secondary}
    knocked = {event.entity for event in rollout.events if event.secondary} - direct
    return math.fsum(scene.entities[name].severity[component] for name in knocked)


def worst_severities(
    rollout: Rollout, scene: Scene, factor: Callable[[str, ContactEvent], float] = lambda category, event: 1.0
) -> dict[str, float]:
    """Return each touched entity's share in the impact: the worst that a component did to it.

    Args:
        rollout: What happened.
        scene: Where.
        factor: What each severity is multiplied by, of an entity's class and a contact.
    """
    worst: dict[str, float] = {}
    for event in rollout.events:
        if not event.secondary:
            entity = scene.entities[event.entity]
            value = entity.severity[event.striker] * factor(entity.category, event)
            worst[event.entity] = max(value, worst.get(event.entity, 0.0))
    return worst

"""Impact of a rollout in the planner's unit and by its rule: the sum of the severities of all touches.

Each component counts once against each entity that it touches. The carried object itself counts as an entity. A
landing damages it with a probability that depends on the energy of the touch. Of several landings only the most
damaging one counts, since the object either survives that one or does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from failbench.recording.records import ContactEvent
from graceful_plan import Scene
from graceful_plan.costs.models.failing_base import failing_base
from graceful_plan.scene.harm.fragility import FragilityTable


@runtime_checkable
class Touches(Protocol):
    """Contacts that scores are computed from: those of a `Rollout`, or of a healthy run."""

    @property
    def events(self) -> tuple[ContactEvent, ...]:
        """Contacts with entities."""
        ...

    @property
    def landings(self) -> tuple[ContactEvent, ...]:
        """Other contacts of the carried object, see `Rollout`."""
        ...


def observed_impact(rollout: Touches, scene: Scene, *, own: bool = True) -> float:
    """Return the sum of severities over components and the entities that they touch.

    Args:
        rollout: The contacts.
        scene: Scene with the severities.
        own: Whether to add the loss of the carried object itself, see `own_loss`.
    """
    return math.fsum(impact_by_entity(rollout, scene, own=own).values())


def energy_impact(
    rollout: Touches, scene: Scene, fragility: FragilityTable | None = None, *, own: bool = True
) -> float:
    """Return the observed impact with each severity times the damage probability at the energy of the first touch.

    Args:
        rollout: The contacts.
        scene: Scene with the severities.
        fragility: Fragility of entities and carried object; the shipped table by default.
        own: Whether to add the loss of the carried object itself.
    """
    table = FragilityTable.shipped() if fragility is None else fragility
    return math.fsum(impact_by_entity(rollout, scene, table, own=own, factor=damage_by_energy(table)).values())


def damage_by_energy(fragility: FragilityTable) -> Callable[[str, ContactEvent], float]:
    """Return the damage probability at the energy of a touch, as a factor for `impact_by_entity`."""
    return lambda category, event: fragility.probability(category, event.striker, event.energy)


def secondary_impact(rollout: Touches, scene: Scene) -> float:
    """Return the sum of the severities of entities that only other entities touch.

    Each counts with its severity for a touch by the carried object, or by the body if nothing is carried.
    """
    component = "carried" if "carried" in scene.components else "body"
    direct = {event.entity for event in rollout.events if not event.secondary}
    knocked = {event.entity for event in rollout.events if event.secondary} - direct
    return math.fsum(scene.entities[name].severity[component] for name in knocked)


def own_loss(rollout: Touches, scene: Scene, fragility: FragilityTable | None = None) -> float:
    """Return the severity of the loss of the carried object itself, times its damage probability.

    Args:
        rollout: The contacts.
        scene: Scene with the severities.
        fragility: Fragility of the object; the shipped table by default.
    """
    return scene.own_severity * own_damage(rollout, scene, fragility)


def own_damage(rollout: Touches, scene: Scene, fragility: FragilityTable | None = None) -> float:
    """Return the probability that a touch of the carried object damages it; 0 if nothing is carried."""
    if scene.carried is None:
        return 0.0
    table = FragilityTable.shipped() if fragility is None else fragility
    kind = scene.components["carried"].component_class
    touches = [event for event in rollout.events if event.striker == "carried" and not event.secondary]
    found = [
        table.loss(kind, scene.entities[event.entity].category if event.entity else "", event.energy)
        for event in (*touches, *rollout.landings)
    ]
    return max(found, default=0.0)


def greatest_touch(scene: Scene, *, own: bool = True) -> float:
    """Return the greatest severity of a single touch.

    Args:
        scene: Scene with the severities.
        own: Whether the loss of the carried object itself counts, see `own_loss`.
    """
    touches = [severity for entity in scene.entities.values() for severity in entity.severity.values()]
    return max([*touches, scene.own_severity if own else 0.0])


def impact_by_entity(
    rollout: Touches,
    scene: Scene,
    fragility: FragilityTable | None = None,
    *,
    own: bool = True,
    factor: Callable[[str, ContactEvent], float] | None = None,
) -> dict[str, float]:
    """Return the impact of each touched entity by name, with the carried object's own loss last under its own name.

    Args:
        rollout: The contacts.
        scene: Scene with the severities.
        fragility: Fragility of the carried object; the shipped table by default.
        own: Whether to add the loss of the carried object itself.
        factor: Multiplier of each severity, a function of the entity's class and the contact. The default is 1. For the
            body of a driving base it is min(1, (speed / u)^2) as in the base's coast model, where u is the reference
            speed of the severities.
    """
    found: dict[str, float] = {}
    for event in rollout.events:
        if not event.secondary:
            entity = scene.entities[event.entity]
            share = _worth(event, scene) if factor is None else factor(entity.category, event)
            value = entity.severity[event.striker] * share
            found[event.entity] = found.get(event.entity, 0.0) + value
    if own and scene.carried is not None:
        found[scene.carried.body] = own_loss(rollout, scene, fragility)
    return found


def _worth(event: ContactEvent, scene: Scene) -> float:
    base = failing_base(scene) if event.striker == "body" else None
    return 1.0 if base is None else base.worth(event.speed)

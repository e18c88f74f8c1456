"""What a rollout cost, in the planner's unit and by its rule: severities of all that happened, added up.

Each component counts against each entity that it touched, once. The carried object itself is one of the entities: what
it falls on damages it with a probability that depends on the energy of the touch, and of several touches the one counts
that damages it the most, since it either bears that or does not.
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
    """What scores are made of: a `Rollout`, or what a healthy run does."""

    @property
    def events(self) -> tuple[ContactEvent, ...]:
        """Contacts with entities."""
        ...

    @property
    def landings(self) -> tuple[ContactEvent, ...]:
        """What else the carried object touched."""
        ...


def observed_impact(rollout: Touches, scene: Scene, *, own: bool = True) -> float:
    """Return the sum of severities over components and the entities that they touched.

    Args:
        rollout: What happened.
        scene: Where.
        own: Whether the carried object itself is one of the entities, see `own_loss`.
    """
    return math.fsum(impact_by_entity(rollout, scene, own=own).values())


def energy_impact(
    rollout: Touches, scene: Scene, fragility: FragilityTable | None = None, *, own: bool = True
) -> float:
    """Return the same, with each severity times the probability of damage at the energy of the first touch.

    Args:
        rollout: What happened.
        scene: Where.
        fragility: How easily things are damaged; the shipped table by default.
        own: Whether the carried object itself is one of the entities.
    """
    table = FragilityTable.shipped() if fragility is None else fragility

    def damage(category: str, event: ContactEvent) -> float:
        return table.probability(category, event.striker, event.energy)

    return math.fsum(impact_by_entity(rollout, scene, table, own=own, factor=damage).values())


def secondary_impact(rollout: Touches, scene: Scene) -> float:
    """Return the sum of the severities of the entities that nothing but other entities touched.

    An entity that is knocked over counts as if it were the carried object, or the body if nothing is carried.
    """
    component = "carried" if "carried" in scene.components else "body"
    direct = {event.entity for event in rollout.events if not event.secondary}
    knocked = {event.entity for event in rollout.events if event.secondary} - direct
    return math.fsum(scene.entities[name].severity[component] for name in knocked)


def own_loss(rollout: Touches, scene: Scene, fragility: FragilityTable | None = None) -> float:
    """Return the severity of the loss of the carried object itself, times the probability that it is damaged.

    Args:
        rollout: What happened.
        scene: Where.
        fragility: How easily; the shipped table by default.
    """
    return scene.own_severity * own_damage(rollout, scene, fragility)


def own_damage(rollout: Touches, scene: Scene, fragility: FragilityTable | None = None) -> float:
    """Return the probability that what the carried object touched damages it; 0 if nothing is carried."""
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


def impact_by_entity(
    rollout: Touches,
    scene: Scene,
    fragility: FragilityTable | None = None,
    *,
    own: bool = True,
    factor: Callable[[str, ContactEvent], float] | None = None,
) -> dict[str, float]:
    """Return each touched entity's share in the impact, that of the carried object itself last, under its own name.

    Args:
        rollout: What happened.
        scene: Where.
        fragility: How easily the carried object is damaged; the shipped table by default.
        own: Whether it is one of the entities.
        factor: What each severity is multiplied by, of an entity's class and a contact. Default: 1; of the body of a
            base that drives min(1, (speed / u)^2), as its coast model has it, u being the speed that severities are
            for.
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

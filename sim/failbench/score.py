"""What a rollout cost, in the unit of the planner's prediction: severities of the entities that were touched."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

from failbench.records import ContactEvent, Rollout
from graceful_plan import Scene, SettingError
from graceful_plan.yaml_file import Block, read_yaml

_SHIPPED = Path(__file__).parent / "fragility.yaml"


@dataclass(frozen=True)
class Fragility:
    """How easily an entity of some class is damaged.

    Args:
        median: Kinetic energy at which half of them are damaged [J].
        wetted: Probability that contents that reach it do harm.
        spread: Standard deviation of the logarithm of the energy.
    """

    median: float
    wetted: float
    spread: float

    def __post_init__(self) -> None:
        for name, value, valid in (
            ("median", self.median, 0.0 < self.median < math.inf),
            ("spread", self.spread, 0.0 < self.spread < math.inf),
            ("wetted", self.wetted, 0.0 <= self.wetted <= 1.0),
        ):
            if not valid:
                raise SettingError(name, value, "in [0, 1]" if name == "wetted" else "finite and above 0")

    def probability(self, energy: float) -> float:
        """Return the probability of damage by a touch with some kinetic energy [J]; 0 without any."""
        if energy <= 0.0:
            return 0.0
        return 0.5 * math.erfc((math.log(self.median) - math.log(energy)) / (self.spread * math.sqrt(2.0)))


@dataclass(frozen=True)
class FragilityTable:
    """The fragility of each entity class, and that of all classes that are not listed."""

    rows: Mapping[str, Fragility]
    other: Fragility

    @classmethod
    def load(cls, file: str | Path) -> FragilityTable:
        """Read a table laid out like the shipped one.

        Raises:
            SceneError: If the file is broken, with the line.
        """
        root = read_yaml(Path(file))
        root.only("version", "spread", "entities", "other")
        if root["version"].number() != 1:
            raise root["version"].error("only version 1 of fragility tables is known")
        spread = root["spread"].number()
        rows = {category: _fragility(row, spread) for category, row in root["entities"].items()}
        return cls(MappingProxyType(rows), _fragility(root["other"], spread))

    @classmethod
    def shipped(cls) -> FragilityTable:
        """Return the table that comes with FailBench."""
        return _shipped()

    def probability(self, category: str, event: ContactEvent) -> float:
        """Return the probability that an event damaged an entity of some class."""
        row = self.rows.get(category, self.other)
        return row.wetted if event.striker == "contents" else row.probability(event.energy)


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
    return math.fsum(worst_severities(rollout, scene, table.probability).values())


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


def _fragility(row: Block, spread: float) -> Fragility:
    row.only("median", "wetted")
    try:
        return Fragility(row["median"].number(), row["wetted"].number(), spread)
    except SettingError as error:
        raise row.error(str(error)) from None


@cache
def _shipped() -> FragilityTable:
    return FragilityTable.load(_SHIPPED)

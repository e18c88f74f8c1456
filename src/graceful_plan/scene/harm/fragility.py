"""Fragility: the probability of damage as a function of contact energy, for each entity class.

The carried object has its own rows, by its class. When it falls on a soft entity, only a part of the energy counts.

The shipped table is `fragility.yaml`; its sources are in the head of that file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import final

from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.elements import CARRIED_CLASSES
from graceful_plan.yaml_file import Block, YamlTable

_VALID = {"wetted": "in [0, 1]", "hardness": "in (0, 1]"}


@final
@dataclass(frozen=True)
class Fragility:
    """Fragility of an entity class.

    Args:
        median: Kinetic energy at which half of the entities are damaged [J].
        wetted: Probability that contents do harm once they reach the entity.
        spread: Standard deviation of the logarithm of the energy.
        hardness: Fraction of the contact energy that counts for the carried object when it falls on this entity; 1 for
            a rigid entity.
    """

    median: float
    wetted: float
    spread: float
    hardness: float = 1.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name, value, valid in (
            ("median", self.median, 0.0 < self.median < math.inf),
            ("spread", self.spread, 0.0 < self.spread < math.inf),
            ("wetted", self.wetted, 0.0 <= self.wetted <= 1.0),
            ("hardness", self.hardness, 0.0 < self.hardness <= 1.0),
        ):
            if not valid:
                raise SettingError(name, value, _VALID.get(name, "finite and above 0"))

    def probability(self, energy: float) -> float:
        """Return the probability of damage by a contact with this kinetic energy [J]; 0 if it is not positive."""
        if energy <= 0.0:
            return 0.0
        return 0.5 * math.erfc((math.log(self.median) - math.log(energy)) / (self.spread * math.sqrt(2.0)))


@final
@dataclass(frozen=True)
class FragilityTable(YamlTable):
    """The fragility of entity classes, of carried objects by class, and of all other classes.

    Args:
        rows: Fragility by entity class.
        other: Fragility of classes that are not listed.
        carried: Fragility of the carried object on a hard surface, by its class.
    """

    shipped_file = Path(__file__).parent / "fragility.yaml"
    kind = "fragility tables"
    keys = ("spread", "entities", "other", "carried")

    rows: Mapping[str, Fragility]
    other: Fragility
    carried: Mapping[str, Fragility] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", MappingProxyType(dict(self.rows)))
        object.__setattr__(self, "carried", MappingProxyType(dict(self.carried)))

    def __hash__(self) -> int:
        return hash((*sorted(self.rows.items(), key=_name), self.other, *sorted(self.carried.items(), key=_name)))

    def __reduce__(self) -> tuple[type[FragilityTable], tuple[object, ...]]:
        return FragilityTable, (dict(self.rows), self.other, dict(self.carried))  # read-only mappings cannot be pickled

    @classmethod
    def parsed(cls, root: Block) -> FragilityTable:
        """Build the table from the values of a file."""
        spread = root["spread"].number()
        rows = {category: _fragility(row, spread) for category, row in root["entities"].items()}
        own = {} if (carried := root.get("carried")) is None else dict(carried.items())
        if carried is not None:
            carried.only(*CARRIED_CLASSES)
        own = {name: _own_fragility(row, spread) for name, row in own.items()}
        return cls(rows, _fragility(root["other"], spread), own)

    def of(self, category: str) -> Fragility:
        """Return the fragility of an entity class."""
        return self.rows.get(category, self.other)

    def of_carried(self, object_class: str) -> Fragility:
        """Return the fragility of a carried object of this class."""
        return self.carried.get(object_class, self.other)

    def loss(self, object_class: str, category: str, energy: float) -> float:
        """Return the probability that the carried object is damaged in a fall.

        Args:
            object_class: Class of the carried object.
            category: Class of the entity it falls on; "" for surroundings that are not an entity.
            energy: Kinetic energy of the contact [J].
        """
        return self.of_carried(object_class).probability(energy * self.of(category).hardness)

    def probability(self, category: str, striker: str, energy: float) -> float:
        """Return the probability that an entity is damaged by a component.

        Args:
            category: Class of the entity.
            striker: The component that touches it; for "contents", the energy does not matter.
            energy: Kinetic energy of the contact [J].
        """
        row = self.of(category)
        return row.wetted if striker == "contents" else row.probability(energy)


def _name(item: tuple[str, Fragility]) -> str:
    return item[0]


def _fragility(row: Block, spread: float) -> Fragility:
    row.only("median", "wetted", "hardness")
    hardness = row.get("hardness")
    try:
        return Fragility(
            row["median"].number(), row["wetted"].number(), spread, 1.0 if hardness is None else hardness.number()
        )
    except SettingError as error:
        raise row.error(str(error)) from None


def _own_fragility(row: Block, spread: float) -> Fragility:
    row.only("median")
    try:
        return Fragility(row["median"].number(), 0.0, spread)
    except SettingError as error:
        raise row.error(str(error)) from None

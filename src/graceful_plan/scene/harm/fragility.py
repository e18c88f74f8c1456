"""How easily things are damaged: the probability of damage by the energy of a touch, for each entity class.

The carried object has rows of its own, by its class. Falling on something soft takes a part of the energy only.

The shipped table is `fragility.yaml`; what it rests on is in the head of that file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import final

from graceful_plan.exceptions import SettingError
from graceful_plan.scene.elements import CARRIED_CLASSES
from graceful_plan.yaml_file import Block, YamlTable

_VALID = {"wetted": "in [0, 1]", "hardness": "in (0, 1]"}


@final
@dataclass(frozen=True)
class Fragility:
    """How easily an entity of some class is damaged.

    Args:
        median: Kinetic energy at which half of them are damaged [J].
        wetted: Probability that contents that reach it do harm.
        spread: Standard deviation of the logarithm of the energy.
        hardness: Share of the energy of a touch that counts for the carried object when that falls on it; 1 for what
            does not give way.
    """

    median: float
    wetted: float
    spread: float
    hardness: float = 1.0

    def __post_init__(self) -> None:
        for name, value, valid in (
            ("median", self.median, 0.0 < self.median < math.inf),
            ("spread", self.spread, 0.0 < self.spread < math.inf),
            ("wetted", self.wetted, 0.0 <= self.wetted <= 1.0),
            ("hardness", self.hardness, 0.0 < self.hardness <= 1.0),
        ):
            if not valid:
                raise SettingError(name, value, _VALID.get(name, "finite and above 0"))

    def probability(self, energy: float) -> float:
        """Return the probability of damage by a touch with some kinetic energy [J]; 0 without any."""
        if energy <= 0.0:
            return 0.0
        return 0.5 * math.erfc((math.log(self.median) - math.log(energy)) / (self.spread * math.sqrt(2.0)))


@final
@dataclass(frozen=True)
class FragilityTable(YamlTable):
    """The fragility of each entity class, that of the carried object by its class, and that of all that is not listed.

    Args:
        rows: By entity class.
        other: Of what is listed in neither.
        carried: Of the carried object itself, on something hard.
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
        """Make it of the values in a file."""
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
        """Return the fragility of a carried object of some class."""
        return self.carried.get(object_class, self.other)

    def loss(self, object_class: str, category: str, energy: float) -> float:
        """Return the probability that the carried object is damaged.

        Args:
            object_class: Its class.
            category: Class of what it falls on; "" for what is no entity.
            energy: Kinetic energy of the touch [J].
        """
        return self.of_carried(object_class).probability(energy * self.of(category).hardness)

    def probability(self, category: str, striker: str, energy: float) -> float:
        """Return the probability that an entity of some class is damaged.

        Args:
            category: The class.
            striker: The component that touches it; of the contents, the energy does not matter.
            energy: Kinetic energy of the touch [J].
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

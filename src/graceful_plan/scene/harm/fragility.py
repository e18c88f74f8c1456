"""How easily things are damaged: the probability of damage by the energy of a touch, for each entity class.

The shipped table is `fragility.yaml`; what it rests on is in the head of that file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import final

from graceful_plan.exceptions import SettingError
from graceful_plan.yaml_file import Block, YamlTable


@final
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


@final
@dataclass(frozen=True)
class FragilityTable(YamlTable):
    """The fragility of each entity class, and that of all classes that are not listed."""

    shipped_file = Path(__file__).parent / "fragility.yaml"
    kind = "fragility tables"
    keys = ("spread", "entities", "other")

    rows: Mapping[str, Fragility]
    other: Fragility

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", MappingProxyType(dict(self.rows)))

    def __hash__(self) -> int:
        return hash((tuple(sorted(self.rows)), tuple(self.rows[name] for name in sorted(self.rows)), self.other))

    def __reduce__(self) -> tuple[type[FragilityTable], tuple[object, ...]]:
        return FragilityTable, (dict(self.rows), self.other)  # a read-only mapping cannot be pickled

    @classmethod
    def parsed(cls, root: Block) -> FragilityTable:
        """Make it of the values in a file."""
        spread = root["spread"].number()
        rows = {category: _fragility(row, spread) for category, row in root["entities"].items()}
        return cls(rows, _fragility(root["other"], spread))

    def of(self, category: str) -> Fragility:
        """Return the fragility of an entity class."""
        return self.rows.get(category, self.other)

    def probability(self, category: str, striker: str, energy: float) -> float:
        """Return the probability that an entity of some class is damaged.

        Args:
            category: The class.
            striker: The component that touches it; of the contents, the energy does not matter.
            energy: Kinetic energy of the touch [J].
        """
        row = self.of(category)
        return row.wetted if striker == "contents" else row.probability(energy)


def _fragility(row: Block, spread: float) -> Fragility:
    row.only("median", "wetted")
    try:
        return Fragility(row["median"].number(), row["wetted"].number(), spread)
    except SettingError as error:
        raise row.error(str(error)) from None

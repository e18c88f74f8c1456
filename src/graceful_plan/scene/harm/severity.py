"""Severity of an impact: a table by entity class and component class, read from YAML, overridable per scene.

The shipped table is `severity.yaml`; its reference values are in the head of that file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError
from graceful_plan.path import is_real
from graceful_plan.yaml_file import Block, YamlTable

ITSELF = "carried"
"""Row of the table for losing the carried object itself, by its class."""

SCALE = MappingProxyType(
    {
        0.5: "wipe-up",
        2.0: "minor damage, up to about 20 USD",
        5.0: "moderate damage, or pain without injury",
        10.0: "high damage, from about 200 USD, or first aid",
        20.0: "major property damage, or a moderate injury",
        50.0: "serious injury",
        100.0: "severe injury",
    }
)
"""What severities mean; the source is the head of `severity.yaml`."""
MAX_SEVERITY = 1e6
"""Largest severity; the shipped table has at most 100. Sums over all entities stay finite."""


@final
@dataclass(frozen=True)
class SeverityTable(YamlTable):
    """Severity of each component class for each entity class.

    Args:
        rows: Severity by entity class, then component class; at least 0. A missing pair is undefined.
        components: Names of the component classes.
    """

    shipped_file = Path(__file__).parent / "severity.yaml"
    kind = "severity tables"
    keys = ("components", "entities")

    rows: Mapping[str, Mapping[str, float]]
    components: tuple[str, ...]

    def __post_init__(self) -> None:
        frozen = {category: MappingProxyType(self._checked(category, row)) for category, row in self.rows.items()}
        object.__setattr__(self, "rows", MappingProxyType(frozen))

    def __reduce__(self) -> tuple[type[SeverityTable], tuple[dict[str, dict[str, float]], tuple[str, ...]]]:
        """Return the arguments for a copy or pickle, as plain dictionaries because mapping views cannot be pickled."""
        return SeverityTable, ({category: dict(row) for category, row in self.rows.items()}, self.components)

    @classmethod
    def parsed(cls, root: Block) -> SeverityTable:
        """Build the table from the values of a file."""
        components = root["components"].strings()
        rows: dict[str, dict[str, float]] = {}
        for category, row in root["entities"].items():
            values = row.entries()
            if len(values) != len(components):
                raise row.error(f"{category} has {len(values)} severities for {len(components)} component classes")
            rows[category] = {c: v.number() for c, v in zip(components, values, strict=True) if not v.is_null}
            if min(rows[category].values(), default=0.0) < 0.0:
                raise row.error(f"a severity of {category} is below 0")
        return cls(rows, components)

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the entity classes."""
        return tuple(self.rows)

    def severity(self, category: str, component: str) -> float:
        """Look up one severity.

        Raises:
            UnknownNameError: If there is no such entity class or component class.
            SceneError: If the table does not define this pair.
        """
        self.check_class(category)
        self._check_component(component)
        row = self.rows[category]
        if component not in row:
            raise SceneError(
                f"no severity of {component!r} against {category!r}; defined for {category!r}: {', '.join(row)}"
            )
        return row[component]

    def with_overrides(self, overrides: Mapping[str, float | Mapping[str, float]]) -> SeverityTable:
        """Return the table with some values replaced.

        Args:
            overrides: By entity class, one number for all component classes or numbers by component class. New classes
                are added.
        """
        if not overrides:
            return self  # the table cannot change, and is long to check
        rows = {category: dict(row) for category, row in self.rows.items()}
        for category, values in overrides.items():
            if not isinstance(values, Mapping):
                values = dict.fromkeys(self.components, values)
            rows.setdefault(category, {}).update(values)
        return SeverityTable(rows, self.components)

    def check_class(self, category: str) -> None:
        """Raise UnknownNameError if there is no such entity class."""
        if not isinstance(category, str) or category not in self.rows:
            raise UnknownNameError("entity class", category, self.rows)

    def _checked(self, category: str, row: Mapping[str, float]) -> dict[str, float]:
        for component in row:
            self._check_component(component)
        return {name: check_severity(f"severity of {name} against {category}", value) for name, value in row.items()}

    def _check_component(self, component: str) -> None:
        if component not in self.components:
            raise UnknownNameError("component class", component, self.components)


def given_severity(
    given: SeverityTable | Mapping[str, Any] | str | Path | None,
) -> tuple[SeverityTable, dict[str, Any]]:
    """Return the table given as an object or file, or else the shipped one, and the overrides to apply to it."""
    if isinstance(given, SeverityTable):
        return given, {}
    if isinstance(given, str | Path):
        return SeverityTable.load(given), {}
    return SeverityTable.shipped(), dict(given or {})


def check_severity(name: str, value: object) -> float:
    """Return a severity as a float.

    Raises:
        SettingError: If it is not a number from 0 to `MAX_SEVERITY`.
    """
    if not (is_real(value) and 0 <= value <= MAX_SEVERITY):
        raise SettingError(name, value, f"a finite number of at least 0 and at most {MAX_SEVERITY:g}")
    return float(value)

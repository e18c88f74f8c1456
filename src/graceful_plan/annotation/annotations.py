"""Annotations of entities: a YAML file for a person to review, and its application to a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

import yaml

from graceful_plan.annotation.questions import MOST_FRAGILITY, entity_classes
from graceful_plan.exceptions import SettingError, UnknownNameError, names_file
from graceful_plan.path import is_real, plain_numbers
from graceful_plan.regular_file import path_of
from graceful_plan.scene.elements import EntityAnnotation
from graceful_plan.scene.harm.fragility import FragilityTable
from graceful_plan.scene.harm.severity import SeverityTable, check_severity
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import fraction
from graceful_plan.yaml_file import Block, read_yaml

_HEAD = """\
# Severity of the harm if a failing robot reaches these entities, estimated by a model. It may be wrong: review and
# correct it, then `Annotations.load(file).apply(scene)`.
# class: row of the severity table. fragility: energy that damages half [J]. significance: of its loss, 0 to 1.
# severity: by the component that reaches it; 0 none, 2 minor, 5 moderate or pain, 10 high or first aid, 50 a serious,
# 100 a severe injury.
"""
_KEYS = ("class", "fragility", "significance", "severity", "reason")


@final
@dataclass(frozen=True, kw_only=True)
class Annotation:
    """Annotation of one entity.

    Args:
        category: Class in the severity table.
        fragility: Kinetic energy of a contact that damages half of such entities [J].
        significance: Significance of its loss, from 0 to 1. For information only: nothing is computed from it.
        severity: Severity by component class.
        reason: Reason for these values.

    Raises:
        SettingError: If a number is out of its range.
    """

    category: str
    fragility: float
    significance: float
    severity: Mapping[str, float]
    reason: str = ""

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not (is_real(self.fragility) and 0.0 < self.fragility <= MOST_FRAGILITY):
            raise SettingError("fragility", self.fragility, f"a number above 0 and at most {MOST_FRAGILITY:g}")
        fraction("significance", self.significance, "a number from 0 to 1")
        row = {name: check_severity(f"severity of {name}", value) for name, value in self.severity.items()}
        object.__setattr__(self, "severity", MappingProxyType(row))

    def __reduce__(self) -> tuple[partial[Annotation], tuple[()]]:
        # Read-only mappings cannot be pickled.
        return partial(Annotation, **{**vars(self), "severity": dict(self.severity)}), ()


@final
@dataclass(frozen=True, kw_only=True)
class Annotations:
    """Annotations of the entities of a scene.

    Args:
        scene: Name of the scene.
        model: Name of the model that answered.
        endpoint: URL of its server.
        pictures: Whether the question had pictures.
        rows: Annotation by entity.
    """

    scene: str
    model: str
    endpoint: str
    pictures: bool
    rows: Mapping[str, Annotation]

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", MappingProxyType(dict(self.rows)))

    def __reduce__(self) -> tuple[partial[Annotations], tuple[()]]:
        return partial(Annotations, **{**vars(self), "rows": dict(self.rows)}), ()

    def to_document(self) -> dict[str, Any]:
        """Return the content of the file as a dictionary."""
        rows = {
            name: {
                "class": row.category,
                "fragility": row.fragility,
                "significance": row.significance,
                "severity": dict(row.severity),
                "reason": row.reason,
            }
            for name, row in self.rows.items()
        }
        about = {"scene": self.scene, "model": self.model, "endpoint": self.endpoint, "pictures": self.pictures}
        return {"version": 1, **about, "entities": rows}

    def save(self, file: str | Path) -> None:
        """Write a YAML file."""
        text = yaml.dump(
            self.to_document(), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=140, default_flow_style=False
        )
        Path(file).write_text(_HEAD + text, encoding="utf-8")

    @classmethod
    @names_file
    def load(cls, file: str | Path, table: SeverityTable | None = None) -> Annotations:
        """Read a YAML file written by `save`; severities may be missing.

        Args:
            file: The file.
            table: Severity table with the valid classes and component classes; the shipped one by default.

        Raises:
            SceneError: If the file is malformed, or a name or number in it is invalid; with the line.
        """
        root = read_yaml(path_of(file))
        root.only("version", "scene", "model", "endpoint", "pictures", "entities")
        root.check_version("annotations")
        table = table or SeverityTable.shipped()
        return cls(
            scene=root["scene"].string(),
            model=root["model"].string(),
            endpoint=root["endpoint"].string(),
            pictures=root["pictures"].flag(),
            rows={name: _row(block, table) for name, block in root["entities"].items()},
        )

    def apply(self, scene: Scene) -> Scene:
        """Return a scene whose annotated entities have these classes and severities.

        Raises:
            UnknownNameError: If the scene lacks an entity, or its severity table a class or component class.
        """
        table, notes = scene.notes.severity, scene.notes
        for name, row in self.rows.items():
            if name not in notes.entities:
                raise UnknownNameError("entity", name, notes.entities)
            table.check_class(row.category)
        said = {name: EntityAnnotation(category=row.category, severity=row.severity) for name, row in self.rows.items()}
        left = {name: value for name, value in notes.overrides.items() if name not in self.rows}
        changed = replace(notes, entities={**notes.entities, **said}, overrides=left)
        return Scene.assemble(scene.posed, changed)

    def fragility(self, table: FragilityTable | None = None) -> FragilityTable:
        """Return a table with these fragilities, for `ImpactCost(consequence=...)`.

        A table has one row per class, so the most fragile entity of a class determines it.

        Args:
            table: Table for all other classes and values; the shipped one by default.
        """
        table = table or FragilityTable.shipped()
        least: dict[str, float] = {}
        for row in self.rows.values():
            least[row.category] = min(row.fragility, least.get(row.category, row.fragility))
        said = {category: replace(table.of(category), median=median) for category, median in least.items()}
        return FragilityTable({**table.rows, **said}, table.other, table.carried)


class _Dumper(yaml.SafeDumper):
    """Dumper that writes each row of severities on one line and does not wrap long texts."""

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> yaml.MappingNode:
        """Write a mapping that contains only numbers on one line."""
        numbers = bool(mapping) and all(isinstance(value, float) for value in mapping.values())
        return super().represent_mapping(tag, mapping, flow_style=numbers or flow_style)


def _row(block: Block, table: SeverityTable) -> Annotation:
    block.only(*_KEYS)
    category, severity, reason = block["class"], block["severity"], block.get("reason")
    try:
        if category.string() not in entity_classes(table):
            raise category.error(str(UnknownNameError("entity class", category.string(), entity_classes(table))))
        for component, child in severity.items():
            if component not in table.components:
                raise child.error(str(UnknownNameError("component class", component, table.components)))
        return Annotation(
            category=category.string(),
            fragility=block["fragility"].number(),
            significance=block["significance"].number(),
            severity={component: child.number() for component, child in severity.items() if not child.is_null},
            reason="" if reason is None else reason.string(),
        )
    except SettingError as error:
        raise block.error(f"{block.name}: {error}") from None

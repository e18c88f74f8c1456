"""Agreement of annotations with the existing classes and severities of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from graceful_plan.annotation.annotations import Annotations
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.elements import BODY_CLASSES, CARRIED_CLASSES
from graceful_plan.scene.scene import Scene


@final
@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Agreement of annotations with a scene, as shares from 0 to 1.

    Args:
        entities: Number of compared entities.
        pairs: Number of compared severities: pairs of entity and component class that both sides define.
        same_class: Share of the entities with the same class.
        same_row: Share of the entities with identical severities.
        within_two: Share of the severities that differ by a factor of at most 2, or are both 0.
        rank_correlation: Spearman's coefficient over all severities; None if one side is constant.
    """

    entities: int
    pairs: int
    same_class: float
    same_row: float
    within_two: float
    rank_correlation: float | None

    def to_document(self) -> dict[str, Any]:
        """Return the values as a dictionary for JSON."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def __str__(self) -> str:
        ranks = "undefined" if self.rank_correlation is None else f"{self.rank_correlation:.2f}"
        return (
            f"{self.entities} entities: same class {self.same_class:.0%}, same row {self.same_row:.0%}; {self.pairs}"
            f" severities: within a factor of 2 {self.within_two:.0%}, rank correlation {ranks}"
        )


def compared(annotations: Annotations, scene: Scene) -> Agreement:
    """Compare annotations with the classes and severities of the same entities in a scene.

    Raises:
        UnknownNameError: If an annotated entity is not in the scene.
    """
    said: list[float] = []
    known: list[float] = []
    classes = rows = 0
    for name, row in annotations.rows.items():
        if name not in scene.notes.entities:
            raise UnknownNameError("entity", name, scene.notes.entities)
        own = severity_row(scene, name)
        both = [component for component in own if component in row.severity]
        classes += row.category == scene.notes.entities[name].category
        rows += all(row.severity[component] == own[component] for component in both)
        said += [row.severity[component] for component in both]
        known += [own[component] for component in both]
    count, a, b = len(annotations.rows), np.array(said), np.array(known)
    close = (a <= 2.0 * b) & (b <= 2.0 * a)
    return Agreement(
        entities=count,
        pairs=len(a),
        same_class=classes / max(1, count),
        same_row=rows / max(1, count),
        within_two=float(close.mean()) if len(a) else 0.0,
        rank_correlation=_ranks(a, b),
    )


def severity_row(scene: Scene, name: str) -> dict[str, float]:
    """Return the severities of an entity by component class: its own, else those of its class.

    All component classes are listed, regardless of the carried object.
    """
    notes = scene.notes
    own_class = notes.entities[name].category
    by_class = {key: value for key, value in notes.overrides.items() if key in notes.severity.classes}
    row = dict(notes.severity.with_overrides(by_class).rows[own_class])
    for declared in (notes.entities[name].severity, notes.overrides.get(name)):
        if declared is None:
            continue
        if not isinstance(declared, Mapping):
            row = dict.fromkeys(notes.severity.components, float(declared))
            continue
        for component in notes.severity.components:
            for key in (component, _component_of(component)):  # a severity of a component holds for all its classes
                row |= {component: float(declared[key])} if key in declared else {}
    return row


def _component_of(component_class: str) -> str:
    if component_class in BODY_CLASSES:
        return "body"
    return "carried" if component_class in CARRIED_CLASSES else "contents"


def _ranks(a: np.ndarray, b: np.ndarray) -> float | None:
    from scipy.stats import rankdata

    if len(a) < 2 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return None
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])

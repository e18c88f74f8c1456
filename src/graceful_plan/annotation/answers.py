"""Parsing and validation of a model's answer; every problem names the entity and the field."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from graceful_plan.annotation.annotations import Annotation
from graceful_plan.annotation.questions import MOST_FRAGILITY, WORST, entity_classes
from graceful_plan.exceptions import AnnotationError
from graceful_plan.scene.harm.severity import SeverityTable

_FIELDS = ("class", "fragility", "significance", "severity", "reason")
_REASON = 1000
"""Maximum length of a reason [characters]."""


def read_answer(text: str, names: Sequence[str], table: SeverityTable) -> dict[str, Annotation]:
    """Parse an answer into annotations, in the order of the question.

    Args:
        text: Answer of the model: a JSON object, alone, in a fenced block or with text around it.
        names: Entities in the question.
        table: Severity table with the valid classes and component classes.

    Raises:
        AnnotationError: If the answer is unusable; lists all problems.
    """
    rows = _entities(text)
    problems = [f"entity {name!r} is missing" for name in names if name not in rows]
    problems += [f"entity {_short(name)} was not asked about" for name in rows if name not in names]
    for name in names:
        if name in rows:
            problems += [f"entity {name!r}: {problem}" for problem in _problems(rows[name], table)]
    if problems:
        raise AnnotationError(problems)
    return {
        name: Annotation(
            category=rows[name]["class"],
            fragility=float(rows[name]["fragility"]),
            significance=float(rows[name]["significance"]),
            severity={component: float(rows[name]["severity"][component]) for component in table.components},
            reason=_line(rows[name]["reason"]),
        )
        for name in names
    }


def _entities(text: str) -> dict[str, Any]:
    start, end = text.find("{"), text.rfind("}")
    if start < 0 or end < start:
        raise AnnotationError(["it has no JSON object"])
    try:
        document = json.loads(text[start : end + 1], object_pairs_hook=_once, parse_constant=_no_constant)
    except _Twice as error:
        raise AnnotationError([f"the key {_short(error.args[0])} stands twice in one object"]) from None
    except (ValueError, RecursionError) as error:
        raise AnnotationError([f"it is not JSON: {str(error)[:200]}"]) from None
    found = document.get("entities")
    if not isinstance(found, dict):
        raise AnnotationError(["it has no object 'entities'"])
    return cast(dict[str, Any], found)


class _Twice(Exception):
    """Duplicate key in a JSON object."""


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise _Twice(key)
        found[key] = value
    return found


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _problems(row: Any, table: SeverityTable) -> Iterator[str]:
    """Yield the problems of the answer for one entity."""
    if not isinstance(row, dict):
        yield "it has to be an object"
        return
    given = cast(dict[str, Any], row)
    missing = [field for field in _FIELDS if field not in given]
    yield from (f"{field!r} is missing" for field in missing)
    yield from (
        f"unknown field {_short(field)}; valid: {', '.join(_FIELDS)}" for field in given if field not in _FIELDS
    )
    classes = entity_classes(table)
    if "class" in given and given["class"] not in classes:
        yield f"unknown class {_short(given['class'])}; valid: {', '.join(classes)}"
    if "fragility" in given and (not _within(given["fragility"], MOST_FRAGILITY) or given["fragility"] == 0):
        yield f"fragility {_short(given['fragility'])} is no number above 0 and at most {MOST_FRAGILITY:g}"
    if "significance" in given and not _within(given["significance"], 1.0):
        yield f"significance {_short(given['significance'])} is no number from 0 to 1"
    if "reason" in given:
        reason = given["reason"]
        if not isinstance(reason, str) or not _line(reason) or len(reason) > _REASON:
            yield f"the reason has to be a text of 1 to {_REASON} characters"
    if "severity" in given:
        yield from _row_problems(given["severity"], table)


def _row_problems(row: Any, table: SeverityTable) -> Iterator[str]:
    if not isinstance(row, Mapping):
        yield "severity has to be an object by column"
        return
    for component in table.components:
        if component not in row:
            yield f"severity has no column {component!r}"
        elif not _within(row[component], WORST):
            yield f"severity of {component!r}, {_short(row[component])}, is no number from 0 to {WORST:g}"
    for component in row:
        if component not in table.components:
            yield f"severity has an unknown column {_short(component)}; valid: {', '.join(table.components)}"


def _within(value: Any, most: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= most


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "..."


def _line(text: str) -> str:
    """Return text on one line, without unprintable characters."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())

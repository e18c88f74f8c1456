"""Read large untrusted YAML into plain values: no anchors, tags, directives or merged mappings; bounded size and depth.

Scalars follow the core schema of YAML 1.2, so 1e-5 is a number, and "on" and "12:30" are texts. `yaml_file` also
records lines, for files that people write, and takes ten times as long.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

from graceful_plan.exceptions import FormatError
from graceful_plan.yaml_file import LOADER, check_directives

MOST_BYTES = 50_000_000
"""Largest size of a file [bytes]; it is read in some 10 s."""
MOST_VALUES = 5_000_000
"""Largest number of scalars, lists and mappings."""
MOST_DEPTH = 24
_LONGEST_NUMBER = 64
"""Length of a scalar above which it is text [characters]: long integers take quadratic time."""
_INTEGER = re.compile(r"[-+]?[0-9]+|0x[0-9a-fA-F]+|0o[0-7]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_WORDS = {word: None for word in ("", "~", "null", "Null", "NULL")}
_WORDS |= {word: True for word in ("true", "True", "TRUE")} | {word: False for word in ("false", "False", "FALSE")}
_WORDS |= {sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in (".inf", ".Inf", ".INF")}
_WORDS |= {word: float("nan") for word in (".nan", ".NaN", ".NAN")}
_BASES = {"0x": 16, "0o": 8}


def parse_yaml_values(text: str, source: str) -> Any:
    """Return the document in a text as mappings, lists, numbers, texts, truth values and None.

    A second document is accepted only if it is empty, as in the output of `ros2 topic echo`.

    Args:
        text: The text.
        source: Name of the file, for errors.

    Raises:
        FormatError: If it is not YAML, has one of the features above, a key twice, or more than one document.
    """
    if (problem := check_directives(text)) is not None:
        raise FormatError(source, problem)
    try:
        events = _Events(yaml.parse(text, Loader=LOADER), source)
        documents = list(events.documents())
    except yaml.MarkedYAMLError as error:
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise FormatError(source, f"broken YAML{line}: {error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise FormatError(source, f"broken YAML: {' '.join(str(error).split())}") from None
    if len(documents) > 1 and documents[1:] != [None]:
        raise FormatError(source, "has more than one document")
    return documents[0] if documents else None


class _Events:
    """Builds values from the events of a parser."""

    def __init__(self, events: Iterator[yaml.Event], source: str) -> None:
        self._events, self._source, self._count = events, source, 0

    def documents(self) -> Iterator[Any]:
        """Yield the value of each document."""
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                yield self._value(next(self._events), 0)

    def _value(self, event: yaml.Event, depth: int) -> Any:
        self._count += 1
        if self._count > MOST_VALUES:
            raise self._error(event, f"more than {MOST_VALUES} values")
        if depth > MOST_DEPTH:
            raise self._error(event, f"nested deeper than {MOST_DEPTH} levels")
        if getattr(event, "anchor", None) is not None:
            raise self._error(event, "anchors and aliases are not read")
        if (tag := getattr(event, "tag", None)) is not None:
            raise self._error(event, f"the tag {tag} is not read")
        if isinstance(event, yaml.ScalarEvent):
            return event.value if event.style else scalar_value(event.value)
        if isinstance(event, yaml.SequenceStartEvent):
            return self._list(depth + 1)
        return self._mapping(depth + 1)

    def _list(self, depth: int) -> list[Any]:
        found = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            found.append(self._value(event, depth))
        return found

    def _mapping(self, depth: int) -> dict[Any, Any]:
        found: dict[Any, Any] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent):
                raise self._error(event, "a key is not a text or number")
            key = self._value(event, depth)
            if key in found:
                raise self._error(event, f"the key {event.value[:40]!r} appears twice")
            if event.value == "<<" and not event.style:
                raise self._error(event, "merged mappings are not read")
            found[key] = self._value(next(self._events), depth)
        return found

    def _error(self, event: yaml.Event, problem: str) -> FormatError:
        return FormatError(self._source, f"{problem} (line {event.start_mark.line + 1})")


def scalar_value(text: str) -> Any:
    """Return the value of a scalar without quotes, by the core schema of YAML 1.2."""
    if text in _WORDS:
        return _WORDS[text]
    if len(text) > _LONGEST_NUMBER:
        return text
    if _INTEGER.fullmatch(text):
        base = _BASES.get(text[:2])
        return int(text) if base is None else int(text[2:], base)
    return float(text) if _FLOAT.fullmatch(text) else text

"""Strictly typed access to a parsed, untrusted document; every error names file and key."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from graceful_plan.exceptions import FormatError


@dataclass(frozen=True)
class Value:
    """A value of a document: a mapping, list, number, text or null.

    For large JSON or YAML documents; `yaml_file` also records lines, and is ten times slower.
    """

    source: str
    """Name of the file."""
    key: str
    """Key of the value, e.g. "box[3].start"; empty for the whole document."""
    plain: object

    def error(self, problem: str) -> FormatError:
        """Return an error about this value."""
        return FormatError(self.source, f"{self.key or 'the document'} {problem}")

    @property
    def is_list(self) -> bool:
        """Whether this is a list."""
        return isinstance(self.plain, list)

    def get(self, name: str) -> Value | None:
        """Return a value of a mapping; None if it is absent or null."""
        value = self._mapping().get(name)
        return None if value is None else Value(self.source, f"{self.key}.{name}".lstrip("."), value)

    def __getitem__(self, name: str) -> Value:
        value = self.get(name)
        if value is None:
            raise self.error(f"needs the key {name!r}")
        return value

    def items(self) -> Iterator[tuple[str, Value]]:
        """Iterate over a mapping with text keys."""
        for name, value in self._mapping().items():
            if not isinstance(name, str) or not name:
                raise self.error(f"has the key {name!r}, which is not a text")
            yield name, Value(self.source, f"{self.key}.{name}".lstrip("."), value)

    def entries(self) -> list[Value]:
        """Return the values of a list."""
        if not isinstance(self.plain, list):
            raise self.error("has to be a list")
        return [Value(self.source, f"{self.key}[{i}]", value) for i, value in enumerate(self.plain)]

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.plain, str):
            raise self.error("has to be a text")
        return self.plain

    def number(self, *, above: float = -math.inf) -> float:
        """Return a finite number, greater than `above`."""
        number = _number(self.plain)
        if number is None:
            raise self.error(f"has to be a number, not {str(self.plain)[:40]!r}")
        if not (math.isfinite(number) and number > above):
            raise self.error(f"= {number:g} has to be {'finite' if above == -math.inf else f'finite and > {above:g}'}")
        return number

    def numbers(self, count: int, *, above: float = -math.inf) -> tuple[float, ...]:
        """Return a list of `count` finite numbers."""
        if not isinstance(self.plain, list):
            raise self.error(f"has to be a list of {count} numbers")
        if len(self.plain) != count:
            raise self.error(f"has {len(self.plain)} values, expected {count} numbers")
        return tuple(value.number(above=above) for value in self.entries())

    def _mapping(self) -> dict[object, object]:
        if not isinstance(self.plain, dict):
            raise self.error("has to be a mapping")
        return self.plain


def _number(value: object) -> float | None:
    """Parse a number, also from text, because YAML 1.1 reads 1e-3 as text."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None

"""Parse untrusted JSON, with bounds on the number and depth of its values, and check the form of objects."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import NoneType
from typing import Any

from graceful_plan.exceptions import FormatError
from graceful_plan.path import is_real, is_whole

MOST_VALUES = 10_000_000
"""Largest number of values of a document; Python needs some 40 bytes for each, however few bytes it has in the text."""
MOST_DEPTH = 100
"""Greatest depth of nested lists and objects, far below the depth at which recursion fails."""
_KINDS: Mapping[type, str] = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "text",
    list: "a list",
    dict: "an object",
    NoneType: "null",
}


def parse_json(text: str | bytes, source: str, **settings: Any) -> Any:
    """Parse JSON text.

    Args:
        text: The text.
        source: Name of the file, for errors.
        settings: Passed to `json.loads`.

    Raises:
        FormatError: If it is not JSON, is nested deeper than `MOST_DEPTH`, or has more than `MOST_VALUES` values.
    """
    marks = b",[{" if isinstance(text, bytes) else ",[{"
    count = sum(text.count(marks[k : k + 1]) for k in range(len(marks)))  # type: ignore[arg-type]
    if count > MOST_VALUES:
        raise FormatError(source, f"has more than {MOST_VALUES} values")
    try:
        document = json.loads(text, **settings)
    except (ValueError, RecursionError) as error:
        raise FormatError(source, f"not JSON: {error}") from None
    level = [document]
    for _ in range(MOST_DEPTH):
        level = [one for many in level for one in _inside(many)]
    if level:
        raise FormatError(source, f"nested deeper than {MOST_DEPTH} levels")
    return document


def _inside(value: Any) -> list[Any]:
    """Return the lists and objects directly inside of a value."""
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [one for one in inside if isinstance(one, (list, dict))]


def check_keys(source: str, document: Any, expected: set[str]) -> None:
    """Check that a document is an object with exactly these keys.

    Raises:
        FormatError: If it is not.
    """
    if not isinstance(document, dict):
        raise FormatError(source, f"an object is expected, not {type(document).__name__}")
    for problem, keys in (("missing", expected - document.keys()), ("unknown", document.keys() - expected)):
        if keys:
            valid = ", ".join(sorted(expected))
            raise FormatError(source, f"{problem} keys: {', '.join(sorted(keys))}; expected: {valid}")


def check_form(source: str, document: Any, form: Mapping[str, type | tuple[type, ...]]) -> None:
    """Check that a document is an object with exactly these keys, and values of these types, or of one of several.

    Raises:
        FormatError: If it is not.
    """
    check_keys(source, document, set(form))
    for key, kind in form.items():
        value = document[key]
        fits = is_real(value) if kind is float else is_whole(value) if kind is int else isinstance(value, kind)
        if not fits:
            expected = " or ".join(_KINDS[one] for one in (kind if isinstance(kind, tuple) else (kind,)))
            raise FormatError(source, f"{key} has to be {expected}, not {value!r:.100}")

"""Parse untrusted JSON, with a bound on the number of its values."""

from __future__ import annotations

import json
from typing import Any

from graceful_plan.exceptions import FormatError

MOST_VALUES = 10_000_000
"""Largest number of values of a document; Python needs some 40 bytes for each, however few bytes it has in the text."""


def parse_json(text: str | bytes, source: str, **settings: Any) -> Any:
    """Parse JSON text.

    Args:
        text: The text.
        source: Name of the file, for errors.
        settings: Passed to `json.loads`.

    Raises:
        FormatError: If it is not JSON, is nested too deeply, or has more than `MOST_VALUES` values.
    """
    marks = b",[{" if isinstance(text, bytes) else ",[{"
    count = sum(text.count(marks[k : k + 1]) for k in range(len(marks)))  # type: ignore[arg-type]
    if count > MOST_VALUES:
        raise FormatError(source, f"has more than {MOST_VALUES} values")
    try:
        return json.loads(text, **settings)
    except (ValueError, RecursionError) as error:
        raise FormatError(source, f"not JSON: {error}") from None

"""What is done of a long benchmark, a line of JSON each, so that an interrupted run goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def read_lines(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the documents of a file, if there is one; a last line that was cut off does not count."""
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True) if file.exists() else []
    yield from (json.loads(line) for line in lines if line.endswith("\n"))

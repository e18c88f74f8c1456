"""Read and write maps and scenarios of the MovingAI benchmarks.

In the files the first row is the uppermost, and x and y start at its left end.

N. R. Sturtevant, "Benchmarks for grid-based pathfinding", IEEE Transactions on Computational Intelligence and AI in
Games 4, 2012. Optimal lengths are octile, in cells, without cutting corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graceful_plan.array_types import Array, Bool
from graceful_plan.exceptions import READ_ERRORS, FormatError, read_error_reason
from graceful_plan.regular_file import path_of, read_content

_FREE = b".GS"
_KNOWN = b".GS@OTW"
_MOST_HEAD = 4096
_MOST_SCENARIOS = 100_000
"""Largest number of scenarios of a file, read in a second; those of the benchmarks have up to some 10,000."""


@dataclass(frozen=True)
class MovingAIScenario:
    """Start and goal on a map, and the length of the shortest path.

    Args:
        start: Column and row of an OccupancyGrid, whose row 0 is the lowest.
        goal: Column and row of the goal.
        length: Length of the shortest octile path [cells].
    """

    start: tuple[int, int]
    goal: tuple[int, int]
    length: float


def read_moving_ai(file: Path, most_cells: int) -> Bool[Array, "row column"]:
    """Read which cells of a .map file are blocked, the lowest row first.

    Raises:
        FormatError: If the file is missing, broken, truncated or too large.
    """
    text = _content(file, 2 * most_cells + _MOST_HEAD)
    lines = text.splitlines()
    height, width = _head(file, lines[:4])
    if not (height > 0 and width > 0 and height * width <= most_cells):
        raise FormatError(str(file), f"{width} x {height} cells; from 1 to {most_cells} are read")
    rows = lines[4:]
    if len(rows) < height:
        raise FormatError(str(file), f"is truncated: {len(rows)} of {height} rows")
    for k, row in enumerate(rows[:height]):
        if len(row) != width:
            raise FormatError(str(file), f"row {k} has {len(row)} cells, expected {width}")
    cells = np.frombuffer(b"".join(rows[:height]), dtype=np.uint8).reshape(height, width)
    if not np.isin(cells, np.frombuffer(_KNOWN, dtype=np.uint8)).all():
        unknown = chr(int(cells[~np.isin(cells, np.frombuffer(_KNOWN, dtype=np.uint8))][0]))
        raise FormatError(str(file), f"unknown kind of cell {unknown!r}; valid: {', '.join(_KNOWN.decode())}")
    return ~np.isin(cells, np.frombuffer(_FREE, dtype=np.uint8))[::-1]


def read_scenarios(file: str | Path) -> list[MovingAIScenario]:
    """Read a .scen file.

    Raises:
        FormatError: If the file is missing, broken or too large.
    """
    file = path_of(file)
    found = []
    lines = _content(file, 200 * _MOST_SCENARIOS).splitlines()
    if len(lines) > _MOST_SCENARIOS + 1:
        raise FormatError(str(file), f"has more than {_MOST_SCENARIOS} scenarios")
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0] == b"version":
            continue
        try:
            if len(words) != 9:
                raise ValueError(f"{len(words)} words")
            _, rows, x0, y0, x1, y1 = (int(word) for word in words[2:8])
            length = float(words[8])
            if not (0 <= y0 < rows and 0 <= y1 < rows and x0 >= 0 and x1 >= 0 and 0.0 <= length < np.inf):
                raise ValueError("numbers out of their range")
        except ValueError as error:
            raise FormatError(f"{file}:{number}", f"is not a scenario: {error}") from None
        found.append(MovingAIScenario((x0, rows - 1 - y0), (x1, rows - 1 - y1), length))
    return found


def write_moving_ai(file: Path, blocked: Bool[Array, "row column"]) -> None:
    """Write a .map file.

    Raises:
        FormatError: If the file cannot be written.
    """
    rows, columns = blocked.shape
    cells = np.where(blocked[::-1], ord("@"), ord(".")).astype(np.uint8)
    lines = np.concatenate([cells, np.full((rows, 1), ord("\n"), dtype=np.uint8)], axis=1)
    _write(file, f"type octile\nheight {rows}\nwidth {columns}\nmap\n".encode() + lines.tobytes())


def _head(file: Path, lines: list[bytes]) -> tuple[int, int]:
    words = [line.split() for line in lines]
    if len(words) < 4 or words[0] != [b"type", b"octile"] or words[3] != [b"map"]:
        raise FormatError(str(file), 'does not begin with "type octile", height, width and "map"')
    try:
        told = {name: int(value) for name, value in words[1:3] if len(value) <= 10}
        return told[b"height"], told[b"width"]
    except (ValueError, KeyError):
        raise FormatError(str(file), "its height and width are not numbers of at most 10 digits") from None


def _content(file: Path, most: int) -> bytes:
    try:
        return read_content(file, most)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None


def _write(file: Path, content: bytes) -> None:
    try:
        file.write_bytes(content)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error).replace("read", "written", 1)) from None

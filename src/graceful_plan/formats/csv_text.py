"""Trajectories as CSV: one row per time, with units in the header."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from graceful_plan.exceptions import FormatError
from graceful_plan.formats.samples import UNITS, TimedSamples, from_columns, text_of

MOST_CELLS = 10_000_000
"""Largest number of cells to read; Python needs some 60 bytes for the text of each."""


def to_csv(samples: TimedSamples) -> str:
    """Return the samples as CSV text."""
    columns = samples.columns
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([f"{name} [{UNITS[name.partition(' ')[0]]}]" for name in columns])
    for row in np.column_stack(list(columns.values())).tolist():
        writer.writerow([repr(x) for x in row])
    return out.getvalue()


def from_csv(source: str | Path) -> TimedSamples:
    """Read the output of `to_csv`, from a file or from text of several lines.

    Raises:
        FormatError: If the text is not such a table; the message names the line.
    """
    name, text = text_of(source, lambda text: "\n" in text, "CSV")
    if text.count(",") + text.count("\n") > MOST_CELLS:
        raise FormatError(name, f"has more than {MOST_CELLS} numbers")
    try:
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except csv.Error as error:
        raise FormatError(name, f"not CSV: {error}") from None
    if not rows:
        raise FormatError(name, "it is empty")
    header, *body = rows
    names = [_without_unit(name, cell) for cell in header]
    table = np.empty((len(body), len(names)))
    for i, row in enumerate(body):
        try:
            table[i] = [float(cell) for cell in row]
        except ValueError:
            raise FormatError(name, f"line {i + 2} is not {len(names)} numbers") from None
    return from_columns(name, names, table)


def _without_unit(source: str, cell: str) -> str:
    """Return the name in a cell of the header, as "q shoulder" of "q shoulder [rad or m]"."""
    name, _, unit = cell.rpartition(" [")
    kind = name.partition(" ")[0]
    if unit.removesuffix("]") != UNITS.get(kind):
        expected = ", ".join(f"{key} [{value}]" for key, value in UNITS.items())
        raise FormatError(source, f"{cell!r} is no column with its unit; expected: {expected}, with names of joints")
    return name

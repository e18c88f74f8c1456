"""Trajectories as Parquet: one row per time, with units in the metadata of each column. Needs pyarrow."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from graceful_plan.exceptions import READ_ERRORS, FormatError, GracefulPlanError, read_error_reason
from graceful_plan.formats.samples import SCHEMA, UNITS, VERSION, TimedSamples, from_columns
from graceful_plan.regular_file import path_of, read_content

MOST_NUMBERS = 2**27
"""Largest number of rows times columns to read: a small file can hold huge runs of equal numbers."""
_KEYS = {b"schema": SCHEMA.encode(), b"version": str(VERSION).encode()}


class MissingArrow(GracefulPlanError, ImportError):
    """Raised if pyarrow is not installed."""

    def __init__(self) -> None:
        super().__init__("Parquet needs pyarrow: pip install 'graceful-plan[data]'; or write CSV instead")


def check_arrow() -> None:
    """Raise MissingArrow if pyarrow is not installed."""
    if importlib.util.find_spec("pyarrow") is None:
        raise MissingArrow


def to_parquet(samples: TimedSamples, file: str | Path) -> None:
    """Write the samples to a file.

    Raises:
        MissingArrow: If pyarrow is not installed.
    """
    check_arrow()
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = samples.columns
    units = [UNITS[name.partition(" ")[0]] for name in columns]
    named = zip(columns, units, strict=True)
    fields = [pa.field(name, pa.float64(), nullable=False, metadata={"unit": unit}) for name, unit in named]
    schema = pa.schema(fields, metadata=_KEYS)
    pq.write_table(pa.table(list(columns.values()), schema=schema), file, compression="zstd")


def from_parquet(file: str | Path) -> TimedSamples:
    """Read the output of `to_parquet`.

    Raises:
        MissingArrow: If pyarrow is not installed.
        FormatError: If the file cannot be read, or has another format, version or unit.
    """
    check_arrow()
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = path_of(file)
    try:
        content = read_content(path)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    try:
        said = pq.read_metadata(pa.BufferReader(content))
        if said.num_rows * said.num_columns > MOST_NUMBERS:
            raise FormatError(str(file), f"{said.num_rows} rows of {said.num_columns} columns are too many")
        table = pq.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError) as error:
        raise FormatError(str(file), f"not Parquet: {error}") from None
    found = table.schema.metadata or {}
    for key, value in _KEYS.items():
        if found.get(key) != value:
            said = (found.get(key) or b"missing").decode(errors="replace")
            raise FormatError(str(file), f"{key.decode()} is {said}, this version reads {value.decode()}")
    for name, values in zip(table.column_names, table.columns, strict=True):
        field = table.schema.field(name)
        unit = (field.metadata or {}).get(b"unit", b"").decode(errors="replace")
        if field.type != pa.float64() or unit != UNITS.get(name.partition(" ")[0]) or values.null_count:
            raise FormatError(str(file), f"column {name!r} has to hold numbers, with its unit: {UNITS}")
    values = [column.to_numpy() for column in table.columns]
    return from_columns(str(file), table.column_names, np.column_stack(values) if values else np.empty((0, 0)))

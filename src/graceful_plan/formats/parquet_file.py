"""Trajectories as Parquet: one row per time, with units in the metadata of each column. Needs pyarrow."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graceful_plan.exceptions import READ_ERRORS, FormatError, GracefulPlanError, read_error_reason
from graceful_plan.formats.samples import SCHEMA, UNITS, VERSION, TimedSamples, from_columns
from graceful_plan.regular_file import path_of, read_content

if TYPE_CHECKING:
    import pyarrow as pa

MOST_VALUES = 2**24
"""Largest number of values to read: a small file can hold huge runs of equal numbers."""
MOST_BYTES = 2**28
"""Largest size of the values to read [bytes]: a small file can hold one long text many times."""
_KEYS = {b"schema": SCHEMA.encode(), b"version": str(VERSION).encode()}


class MissingArrow(GracefulPlanError, ImportError):
    """Raised if pyarrow is not installed."""

    def __init__(self) -> None:
        super().__init__("Parquet needs pyarrow: pip install '.[data]'; or write CSV instead")


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
    path = path_of(file)
    try:
        content = read_content(path)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    table = read_bounded(content, str(file), _problem)
    for name, column in zip(table.column_names, table.columns, strict=True):
        if column.null_count:
            raise FormatError(str(file), f"column {name!r} has to hold numbers, but has nulls")
    values = [column.to_numpy() for column in table.columns]
    return from_columns(str(file), table.column_names, np.column_stack(values) if values else np.empty((0, 0)))


def _problem(schema: pa.Schema) -> str | None:
    """Return why columns are not those of a trajectory; None if they are."""
    import pyarrow as pa

    found = schema.metadata or {}
    for key, value in _KEYS.items():
        if found.get(key) != value:
            said = (found.get(key) or b"missing").decode(errors="replace")
            return f"{key.decode()} is {said}, this version reads {value.decode()}"
    for field in schema:
        unit = (field.metadata or {}).get(b"unit", b"").decode(errors="replace")
        if field.type != pa.float64() or unit != UNITS.get(field.name.partition(" ")[0]):
            return f"column {field.name!r} has to hold numbers, with its unit: {UNITS}"
    return None


def read_bounded(content: bytes, source: str, problem: Callable[[pa.Schema], str | None]) -> pa.Table:
    """Read untrusted Parquet; columns and sizes are checked before any values are read.

    Args:
        content: Content of the file.
        source: Name of the file, for errors.
        problem: Returns why a schema is refused; None if it is accepted.

    Raises:
        FormatError: If it is not Parquet, its schema is refused, or its values exceed `MOST_VALUES` or `MOST_BYTES`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        said, schema = pq.read_metadata(pa.BufferReader(content)), pq.read_schema(pa.BufferReader(content))
        if (refusal := problem(schema)) is not None:
            raise FormatError(source, refusal)
        groups = [said.row_group(i) for i in range(said.num_row_groups)]
        columns = [group.column(k) for group in groups for k in range(group.num_columns)]
        count, size = sum(c.num_values for c in columns), sum(c.total_uncompressed_size for c in columns)
        if count > MOST_VALUES or size > MOST_BYTES or said.num_rows * max(1, said.num_columns) > MOST_VALUES:
            raise FormatError(source, f"{said.num_rows} rows of {said.num_columns} columns are too many")
        leaves = (said.schema.column(k) for k in range(len(said.schema)))
        if texts := [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY"]:
            packed = pq.read_table(pa.BufferReader(content), read_dictionary=texts)
            if sum(_unpacked(chunk) for column in packed.columns for chunk in column.chunks) > MOST_BYTES:
                raise FormatError(source, f"its texts have more than {MOST_BYTES} bytes")
        return pq.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(source, f"not Parquet: {error}") from None


def _unpacked(array: pa.Array) -> int:
    """Return the size of an array whose texts are written out instead of looked up in a dictionary [bytes]."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_dictionary(array.type):
        lengths = pc.fill_null(pc.binary_length(array.dictionary), 0).to_numpy(zero_copy_only=False)
        return int(lengths[array.indices.drop_null().to_numpy(zero_copy_only=False)].sum())
    if pa.types.is_list(array.type):
        return _unpacked(array.flatten())
    if pa.types.is_struct(array.type):
        return sum(map(_unpacked, array.flatten()))
    return array.nbytes

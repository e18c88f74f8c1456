"""Datasets: Parquet parts that other programs can read, and a manifest with their checksums.

A part gets its name when it is complete and on disk, and the manifest is written last. A dataset without a manifest is
therefore unfinished, and one whose parts differ from it is damaged. `read_dataset` rejects both and names the file.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from failbench.basics.chunks import Rows
from failbench.basics.errors import MissingExtra
from failbench.basics.tables import TABLES, VERSION, arrow_schema
from graceful_plan.exceptions import READ_ERRORS, FormatError, read_error_reason
from graceful_plan.formats.parquet_file import read_bounded
from graceful_plan.regular_file import path_of, read_content
from graceful_plan.untrusted_json import parse_json

if TYPE_CHECKING:
    import pyarrow as pa

    from failbench.sweeps.definition import Sweep

MANIFEST = "manifest.json"
PART_ROWS = 5_000
"""Greatest number of rows in a written part; they are kept in memory until it is written, some 30 kB each."""

_SCHEMA = "failbench.dataset"
_TEMPORARY = ".unfinished-"
_PART = re.compile(rf"({'|'.join(TABLES)})/part-[0-9]{{5,9}}\.parquet")
"""Valid names of parts; they exclude paths outside the dataset's folder."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Dataset:
    """A dataset that passed all checks.

    Args:
        rollouts: One row for each rollout.
        contacts: One row for each contact event; its column `rollout` refers to the rollout.
        manifest: Sweep, versions, and checksums.
    """

    rollouts: pa.Table
    contacts: pa.Table
    manifest: Mapping[str, Any]

    @property
    def sweep(self) -> Sweep:
        """The sweep that made the dataset."""
        from failbench.sweeps.definition import Sweep

        return Sweep.from_document(self.manifest["sweep"], f"sweep of {MANIFEST}")


def check_arrow() -> None:
    """Raise MissingExtra if pyarrow is not installed."""
    if importlib.util.find_spec("pyarrow") is None:
        raise MissingExtra("pyarrow", "data")


def write_dataset(folder: Path, rows: Iterable[Rows], about: Mapping[str, Any]) -> dict[str, Any]:
    """Write rows as a dataset, in their order, and return its manifest; replace an earlier dataset.

    Args:
        folder: Folder of the dataset.
        rows: Rows of both tables.
        about: Sweep and versions, for the manifest and every part.

    Raises:
        FormatError: If the folders of the parts hold other files.
        MissingExtra: If pyarrow is not installed.
    """
    check_arrow()
    import pyarrow as pa

    _clear(folder)
    about = {**about, "versions": {**about["versions"], "pyarrow": pa.__version__}}
    writers = {table: _Writer(folder, table, about) for table in TABLES}
    for chunk in rows:
        for table, writer in writers.items():
            writer.add(chunk[table])
    manifest = {
        "schema": _SCHEMA,
        "version": VERSION,
        **about,
        "parts": [part for writer in writers.values() for part in writer.finish()],
        "rows": {table: sum(part["rows"] for part in writer.parts) for table, writer in writers.items()},
        "content": {table: writer.content.hexdigest() for table, writer in writers.items()},
    }
    manifest["sha256"] = _self_checksum(manifest)
    _write(folder / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
    return manifest


def read_dataset(folder: str | Path) -> Dataset:
    """Read a dataset and check that its parts are complete, that there are no others, and that each is unchanged.

    Columns that an earlier version did not have are null.

    Raises:
        FormatError: If it is unfinished, damaged, or of another version; the message names the file.
        MissingExtra: If pyarrow is not installed.
    """
    check_arrow()
    import pyarrow as pa

    folder = path_of(folder)
    manifest = read_manifest(folder)
    parts = {folder / part["file"]: part for part in manifest["parts"]}
    for file in _files(folder):
        if file not in parts:
            raise FormatError(str(file), f"it is not in {MANIFEST}")
    tables: dict[str, list[pa.Table]] = {name: [] for name in TABLES}
    for file, part in parts.items():
        tables[file.parent.name].append(_read_part(file, part, manifest["version"]))
    return Dataset(**{name: pa.concat_tables(found) for name, found in tables.items()}, manifest=manifest)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read and check the manifest of a dataset, without its parts.

    Raises:
        FormatError: If there is none, or it is damaged or of another version.
    """
    file = folder / MANIFEST
    try:
        manifest = parse_json(read_content(file), str(file))
    except FileNotFoundError:
        raise FormatError(str(file), "missing: not a dataset, or an unfinished one") from None
    except FormatError:
        raise
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    if not isinstance(manifest, dict) or manifest.get("schema") != _SCHEMA:
        raise FormatError(str(file), "not a manifest of a dataset")
    if manifest.get("version") not in range(1, VERSION + 1):
        raise FormatError(str(file), f"version {manifest.get('version')!r}; this version reads 1 to {VERSION}")
    if manifest.get("sha256") != _self_checksum(manifest):
        raise FormatError(str(file), "damaged: its checksum does not match")
    _check_fields(manifest, str(file))
    return manifest


def _check_fields(manifest: Mapping[str, Any], file: str) -> None:
    """Reject a malformed manifest with a valid checksum, which anyone can compute."""
    rows, versions, parts = (manifest.get(name) for name in ("rows", "versions", "parts"))
    if not (isinstance(rows, dict) and all(_is_count(rows.get(table)) for table in TABLES)):
        raise FormatError(file, "no numbers of rows of each table")
    named = isinstance(versions, dict) and all(isinstance(versions.get(x), str) for x in ("graceful_plan", "mujoco"))
    if not named:
        raise FormatError(file, "no versions of graceful_plan and mujoco")
    if not isinstance(manifest.get("sweep"), dict):
        raise FormatError(file, "no sweep")
    for k, part in enumerate(parts if isinstance(parts, list) else [None]):
        said = part if isinstance(part, dict) else {}
        texts, counts = ([said.get(name) for name in names] for names in (("file", "sha256"), ("rows", "bytes")))
        if not (all(isinstance(text, str) for text in texts) and all(map(_is_count, counts))):
            raise FormatError(file, f"parts[{k}] does not say file, rows, bytes and checksum")
        if not _PART.fullmatch(said["file"]):
            raise FormatError(file, f"parts[{k}]: {said['file'][:80]!r} is not a valid part name")


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


class _Writer:
    """Collects rows of a table, and writes a part when it is full."""

    def __init__(self, folder: Path, table: str, about: Mapping[str, Any]) -> None:
        self.folder, self.table = folder, table
        texts = {f"failbench.{key}": json.dumps(value) for key, value in about.items()}
        self.schema = arrow_schema(table).with_metadata(
            {"failbench.schema": f"failbench.{table}", "failbench.version": str(VERSION), **texts}
        )
        self.rows: list[dict[str, Any]] = []
        self.parts: list[dict[str, Any]] = []
        self.content = hashlib.sha256()
        """Checksum of all rows as JSON lines, independent of the Parquet encoding."""
        (folder / table).mkdir(parents=True, exist_ok=True)

    def add(self, rows: Iterable[dict[str, Any]]) -> None:
        for row in rows:
            self.content.update((json.dumps(row, sort_keys=True, allow_nan=False) + "\n").encode())
            self.rows.append(row)
            if len(self.rows) == PART_ROWS:
                self._flush()

    def finish(self) -> list[dict[str, Any]]:
        if self.rows or not self.parts:  # a table has at least one part, so that it can be read
            self._flush()
        return self.parts

    def _flush(self) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        buffer = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(self.rows, schema=self.schema), buffer, compression="zstd")
        content = buffer.getvalue().to_pybytes()
        name = f"{self.table}/part-{len(self.parts):05d}.parquet"
        _write(self.folder / name, content)
        checksum = hashlib.sha256(content).hexdigest()
        self.parts.append({"file": name, "rows": len(self.rows), "bytes": len(content), "sha256": checksum})
        self.rows = []


def _write(file: Path, content: bytes) -> None:
    """Write a file atomically: its name never refers to incomplete content, not even after a power failure."""
    temporary = file.with_name(_TEMPORARY + file.name)
    with temporary.open("wb") as out:
        out.write(content)
        out.flush()
        os.fsync(out.fileno())
    temporary.replace(file)
    folder = os.open(file.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _clear(folder: Path) -> None:
    """Remove an earlier export, the manifest first."""
    ours = [file for file in _files(folder) if file.name.startswith(("part-", _TEMPORARY))]
    for file in _files(folder):
        if file not in ours:
            raise FormatError(str(file), "not a part of a dataset, in a folder reserved for parts")
    (folder / MANIFEST).unlink(missing_ok=True)
    for file in ours:
        file.unlink()


def _files(folder: Path) -> Iterator[Path]:
    """Yield all files in the folders of the parts."""
    for table in TABLES:
        if (folder / table).is_dir():
            yield from sorted((folder / table).iterdir())


def _read_part(file: Path, part: Mapping[str, Any], version: int) -> pa.Table:
    import pyarrow as pa

    try:
        content = read_content(file)
    except OSError as error:
        raise FormatError(str(file), f"missing: {error.strerror}") from None
    if len(content) != part["bytes"]:
        raise FormatError(str(file), f"damaged: {len(content)} bytes, {part['bytes']} were written")
    if hashlib.sha256(content).hexdigest() != part["sha256"]:
        raise FormatError(str(file), "damaged: its checksum does not match")
    expected = arrow_schema(file.parent.name, version)
    refusal = f"wrong columns for {file.parent.name}"
    # Parse exactly the bytes that were checked.
    read = read_bounded(content, str(file), lambda found: None if found.equals(expected) else refusal)
    if read.num_rows != part["rows"]:
        raise FormatError(str(file), f"{read.num_rows} rows, {part['rows']} were written")
    schema = arrow_schema(file.parent.name)
    for place, name in enumerate(schema.names):
        if name not in read.schema.names:
            read = read.add_column(place, schema.field(name), pa.nulls(read.num_rows, schema.field(name).type))
    return read


def _self_checksum(manifest: Mapping[str, Any]) -> str:
    """Return the checksum of a manifest without its own checksum."""
    content = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

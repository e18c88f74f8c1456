"""Datasets: Parquet parts that other programs read in one line, and a manifest that knows their checksums.

A part gets its name when it is complete and on disk; the manifest is written last. So a dataset without a manifest is
unfinished, and one whose parts differ from the manifest is damaged; `read_dataset` refuses both by name.
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
from graceful_plan.exceptions import FormatError
from graceful_plan.regular_file import path_of, read_content

if TYPE_CHECKING:
    import pyarrow as pa

    from failbench.sweeps.work import Sweep

MANIFEST = "manifest.json"
PART_ROWS = 5_000
"""Rows of a part, at most; as many are in memory until it is written, some 30 kB each."""
_MOST_ROWS = 100_000
"""Of a part that is read: equal rows take next to nothing in a file."""

_SCHEMA = "failbench.dataset"
_TEMPORARY = ".unfinished-"
_PART = re.compile(rf"({'|'.join(TABLES)})/part-[0-9]{{5,9}}\.parquet")
"""Names of parts: nothing outside of the dataset's own folder is read."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Dataset:
    """A dataset that was found to be whole.

    Args:
        rollouts: One row for each rollout.
        contacts: One row for each contact event; `rollout` says of which rollout.
        manifest: What it was made from and with, and the checksums.
    """

    rollouts: pa.Table
    contacts: pa.Table
    manifest: Mapping[str, Any]

    @property
    def sweep(self) -> Sweep:
        """What it was made from."""
        from failbench.sweeps.work import Sweep

        return Sweep.from_document(self.manifest["sweep"])


def check_arrow() -> None:
    """Raise MissingExtra if no dataset can be written or read here."""
    if importlib.util.find_spec("pyarrow") is None:
        raise MissingExtra("pyarrow", "data")


def write_dataset(folder: Path, rows: Iterable[Rows], about: Mapping[str, Any]) -> dict[str, Any]:
    """Write rows as a dataset, in their order, and return its manifest. What was there before is replaced.

    Args:
        folder: Where.
        rows: Rows of both tables.
        about: Sweep and versions, kept in the manifest and in every part.

    Raises:
        FormatError: If there are files of somebody else where the parts go.
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
    """Read a dataset and check all of it: every part is there, none is too many, and each is what was written.

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
        FormatError: If there is none, or it is damaged, or of another version.
    """
    file = folder / MANIFEST
    try:
        manifest = json.loads(read_content(file))
    except FileNotFoundError:
        raise FormatError(str(file), "missing: no dataset, or one that was never finished") from None
    except OSError as error:
        raise FormatError(str(file), f"cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise FormatError(str(file), f"damaged: {error}") from None
    if not isinstance(manifest, dict) or manifest.get("schema") != _SCHEMA:
        raise FormatError(str(file), "no manifest of a dataset")
    if manifest.get("version") not in range(1, VERSION + 1):
        raise FormatError(str(file), f"version {manifest.get('version')!r}; this version reads 1 to {VERSION}")
    if manifest.get("sha256") != _self_checksum(manifest):
        raise FormatError(str(file), "damaged: its checksum does not fit")
    _check_fields(manifest, str(file))
    return manifest


def _check_fields(manifest: Mapping[str, Any], file: str) -> None:
    """Refuse a manifest whose checksum fits and which is none all the same: anybody can work out a checksum."""
    rows, versions, parts = (manifest.get(name) for name in ("rows", "versions", "parts"))
    if not (isinstance(rows, dict) and all(_is_count(rows.get(table)) for table in TABLES)):
        raise FormatError(file, "no numbers of rows of each table")
    named = isinstance(versions, dict) and all(isinstance(versions.get(x), str) for x in ("graceful_plan", "mujoco"))
    if not named:
        raise FormatError(file, "no versions of what it was made with")
    if not isinstance(manifest.get("sweep"), dict):
        raise FormatError(file, "no sweep that it was made from")
    for k, part in enumerate(parts if isinstance(parts, list) else [None]):
        said = part if isinstance(part, dict) else {}
        texts, counts = ([said.get(name) for name in names] for names in (("file", "sha256"), ("rows", "bytes")))
        if not (all(isinstance(text, str) for text in texts) and all(map(_is_count, counts))):
            raise FormatError(file, f"parts[{k}] does not say file, rows, bytes and checksum")
        if not _PART.fullmatch(said["file"]):
            raise FormatError(file, f"parts[{k}]: {said['file'][:80]!r} is no name of a part")


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


class _Writer:
    """Collects rows of a table and writes a part whenever there are enough."""

    def __init__(self, folder: Path, table: str, about: Mapping[str, Any]) -> None:
        self.folder, self.table = folder, table
        texts = {f"failbench.{key}": json.dumps(value) for key, value in about.items()}
        self.schema = arrow_schema(table).with_metadata(
            {"failbench.schema": f"failbench.{table}", "failbench.version": str(VERSION), **texts}
        )
        self.rows: list[dict[str, Any]] = []
        self.parts: list[dict[str, Any]] = []
        self.content = hashlib.sha256()
        """Checksum of all the rows as JSON lines: the same whatever wrote the Parquet file."""
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
    """Write a file such that its name never stands for less than all of it, not even after a power cut."""
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
    """Remove what an earlier export left behind, the manifest first."""
    ours = [file for file in _files(folder) if file.name.startswith(("part-", _TEMPORARY))]
    for file in _files(folder):
        if file not in ours:
            raise FormatError(str(file), "not a part of a dataset; parts are to be written here")
    (folder / MANIFEST).unlink(missing_ok=True)
    for file in ours:
        file.unlink()


def _files(folder: Path) -> Iterator[Path]:
    """Yield everything that lies where parts belong."""
    for table in TABLES:
        if (folder / table).is_dir():
            yield from sorted((folder / table).iterdir())


def _read_part(file: Path, part: Mapping[str, Any], version: int) -> pa.Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        content = read_content(file)
    except OSError as error:
        raise FormatError(str(file), f"missing: {error.strerror}") from None
    if len(content) != part["bytes"]:
        raise FormatError(str(file), f"damaged: {len(content)} bytes, {part['bytes']} were written")
    if hashlib.sha256(content).hexdigest() != part["sha256"]:
        raise FormatError(str(file), "damaged: its checksum does not fit")
    # The very bytes that were checked are the ones that are read.
    try:
        rows = pq.read_metadata(pa.BufferReader(content)).num_rows
        read = pq.read_table(pa.BufferReader(content)) if rows == part["rows"] <= _MOST_ROWS else None
    except (pa.ArrowException, OSError) as error:
        raise FormatError(str(file), f"not Parquet: {error}") from None
    if read is None or not read.schema.equals(arrow_schema(file.parent.name, version)):
        raise FormatError(str(file), f"not the columns or rows of {file.parent.name}")
    schema = arrow_schema(file.parent.name)
    for place, name in enumerate(schema.names):
        if name not in read.schema.names:
            read = read.add_column(place, schema.field(name), pa.nulls(read.num_rows, schema.field(name).type))
    return read


def _self_checksum(manifest: Mapping[str, Any]) -> str:
    """Return the checksum of a manifest without the one in it."""
    content = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

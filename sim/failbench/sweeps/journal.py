"""The journal of a sweep: finished chunks and their rows, in one SQLite file that survives a kill at any time.

A chunk and its rows are written in one transaction, so a chunk is stored completely or not at all. Only the driver
writes. With a write-ahead log a commit is an append, synced to disk (FULL). A chunk takes a hundred times as long as
the sync, and even a power failure loses no chunk that was reported as done.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import zlib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import quote

from failbench.basics.chunks import Chunk, ChunkOutcome
from failbench.basics.errors import SweepBusy
from graceful_plan.exceptions import FormatError, read_error_reason
from graceful_plan.regular_file import check_regular
from graceful_plan.untrusted_json import parse_json

_SCHEMA = "failbench.journal"
_VERSION = 1
_MOST_BYTES = 2**26
"""Largest size of the rows of a chunk as JSON [bytes]; a rollout has some 30 kB."""
_TABLES = (
    "CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT",
    "CREATE TABLE chunks (id INTEGER PRIMARY KEY, name TEXT NOT NULL, rows BLOB, error TEXT NOT NULL) STRICT",
)


def _checksum(about: Any) -> str:
    return hashlib.sha256(json.dumps(about).encode()).hexdigest()


class SweepJournal:
    """An open journal, locked against other processes. Use it in a `with` statement.

    Args:
        file: File of the journal; created if missing.

    Raises:
        FormatError: If the file is something else, of another version, or damaged.
        SweepBusy: If another process has it open.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.read_only = file.exists() and not os.access(file.parent, os.W_OK)
        """Whether the folder cannot be written, so that nothing can be recorded."""
        with self._errors():
            check_regular(file)
            # SQLite cannot keep a write-ahead log in such a folder, not even an empty one.
            name = f"file:{quote(str(file.resolve()))}?immutable=1" if self.read_only else file
            self._database = sqlite3.connect(name, timeout=0.0, isolation_level=None, uri=self.read_only)
        try:
            with self._errors():
                self._open()
        except BaseException:
            self._database.close()
            raise

    def _open(self) -> None:
        if self.read_only:
            log = self.file.with_name(f"{self.file.name}-wal")
            if log.exists() and log.stat().st_size:
                raise FormatError(str(self.file), f"its folder cannot be written, and {log.name} is not yet part of it")
        else:
            self._lock()
        problems = self._database.execute("PRAGMA quick_check(1)").fetchone()
        if problems != ("ok",):
            raise FormatError(str(self.file), f"damaged: {problems[0]}")
        # The statements are compared, because other tables may hold other types, and triggers run on every change.
        found = {sql for (sql,) in self._database.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL")}
        self.begun = bool(found)
        """Whether the journal contains a sweep."""
        if self.begun and found != set(_TABLES):
            raise FormatError(str(self.file), "a database, but not a journal of a sweep")
        if self.begun and (self._about("schema"), self._about("version")) != (_SCHEMA, _VERSION):
            found = f"{self._about('schema')} version {self._about('version')}"
            raise FormatError(str(self.file), f"{found}; this version reads {_SCHEMA} version {_VERSION}")
        if self.begun and self._about("sha256") != _checksum(self._about("about")):
            raise FormatError(str(self.file), "damaged: the sweep's description does not match its checksum")

    def _lock(self) -> None:
        self._database.execute("PRAGMA locking_mode=EXCLUSIVE")
        if self._database.execute("PRAGMA journal_mode=WAL").fetchone() != ("wal",):
            raise FormatError(str(self.file), "a write-ahead log is not possible there")
        self._database.execute("PRAGMA synchronous=FULL")
        self._database.execute("BEGIN IMMEDIATE")  # takes the lock, which is then kept
        self._database.execute("COMMIT")

    def __enter__(self) -> SweepJournal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._database.close()

    def begin(self, about: Mapping[str, Any]) -> None:
        """Begin a sweep; its description `about` never changes afterwards."""
        with self._errors(), self._transaction():
            for table in _TABLES:
                self._database.execute(table)
            document = {"schema": _SCHEMA, "version": _VERSION, "about": dict(about), "sha256": _checksum(dict(about))}
            self._database.executemany(
                "INSERT INTO about VALUES (?, ?)", [(key, json.dumps(value)) for key, value in document.items()]
            )
        self.begun = True

    @property
    def about(self) -> dict[str, Any]:
        """Description of the sweep, as given to `begin`."""
        with self._errors():
            return self._about("about")

    def record(self, outcome: ChunkOutcome) -> None:
        """Store the outcome of a chunk. A failed chunk can be recorded again, a finished one cannot.

        Raises:
            ValueError: If the chunk is already done.
        """
        chunk, rows = outcome.chunk, None
        if outcome.rows is not None:
            rows = zlib.compress(json.dumps(outcome.rows, allow_nan=False, separators=(",", ":")).encode(), 6)
        with self._errors(), self._transaction():
            self._database.execute("DELETE FROM chunks WHERE id = ? AND rows IS NULL", (chunk.index,))
            try:
                values = (chunk.index, chunk.name, rows, outcome.error)
                self._database.execute("INSERT INTO chunks VALUES (?, ?, ?, ?)", values)
            except sqlite3.IntegrityError:
                raise ValueError(f"{chunk.name} is already done") from None

    def done(self) -> set[int]:
        """Return the indices of the finished chunks."""
        with self._errors():
            return {index for (index,) in self._database.execute("SELECT id FROM chunks WHERE rows IS NOT NULL")}

    def errors(self) -> dict[int, str]:
        """Return the error messages of the failed chunks, by index."""
        with self._errors():
            found = self._database.execute("SELECT id, error FROM chunks WHERE rows IS NULL ORDER BY id")
            return dict(found.fetchall())

    def rows(self, chunk: Chunk) -> Any:
        """Return the rows of a finished chunk, as they were recorded; `check_rows` checks them.

        Raises:
            KeyError: If the chunk is not finished.
            FormatError: If they are damaged or too large.
        """
        with self._errors():
            found = self._database.execute("SELECT length(rows) FROM chunks WHERE id = ?", (chunk.index,)).fetchone()
            if found is None or found[0] is None:
                raise KeyError(chunk.name)
            if found[0] > _MOST_BYTES:
                raise FormatError(str(self.file), f"the rows of {chunk.name} are larger than {_MOST_BYTES} bytes")
            (packed,) = self._database.execute("SELECT rows FROM chunks WHERE id = ?", (chunk.index,)).fetchone()
            unpack = zlib.decompressobj()
            text = unpack.decompress(packed, _MOST_BYTES)
            if not unpack.eof:
                raise FormatError(
                    str(self.file), f"the rows of {chunk.name} are cut, or larger than {_MOST_BYTES} bytes"
                )
            return parse_json(text, str(self.file))

    def _about(self, key: str) -> Any:
        found = self._database.execute("SELECT value FROM about WHERE key = ?", (key,)).fetchone()
        return None if found is None else parse_json(found[0], str(self.file))

    @contextmanager
    def _transaction(self) -> Generator[None]:
        self._database.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            self._database.execute("ROLLBACK")
            raise
        self._database.execute("COMMIT")

    @contextmanager
    def _errors(self) -> Generator[None]:
        """Convert errors of SQLite and the decoders about a bad file to a FormatError that names it."""
        try:
            yield
        except sqlite3.OperationalError as error:
            # Errors raised by Python's module itself have no code.
            if getattr(error, "sqlite_errorcode", None) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                raise SweepBusy(self.file) from None
            raise FormatError(str(self.file), f"cannot be used: {error}") from None
        except OSError as error:
            raise FormatError(str(self.file), read_error_reason(error)) from None
        except (sqlite3.DatabaseError, zlib.error, UnicodeDecodeError) as error:
            raise FormatError(str(self.file), f"damaged, or not a journal of a sweep: {error}") from None

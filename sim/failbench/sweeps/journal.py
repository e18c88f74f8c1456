"""The journal of a sweep: which chunks are done, and their rows. One SQLite file that survives a kill at any moment.

A chunk and its rows are written in one transaction, so a chunk is either there with all of its rows or not at all.
Only the driver writes. With a write-ahead log a commit is an append; it is synced to disk at every commit (FULL): a
chunk costs a hundred times as much as that, and then even a power cut loses nothing that was reported as done.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
import zlib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from failbench.basics.chunks import Chunk, ChunkOutcome, Rows
from failbench.basics.errors import SweepBusy
from graceful_plan.exceptions import FormatError, why_not_read
from graceful_plan.regular_file import check_regular

_SCHEMA = "failbench.journal"
_VERSION = 1
_TABLES = (
    "CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT",
    "CREATE TABLE chunks (id INTEGER PRIMARY KEY, name TEXT NOT NULL, rows BLOB, error TEXT NOT NULL) STRICT",
)


def _checksum(about: Any) -> str:
    return hashlib.sha256(json.dumps(about).encode()).hexdigest()


class SweepJournal:
    """An open journal, which no other process can open meanwhile. Use it in a `with` statement.

    Args:
        file: Where it is or will be.

    Raises:
        FormatError: If the file is something else, of another version, or damaged.
        SweepBusy: If another process has it open.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        with self._errors():
            check_regular(file)
            self._database = sqlite3.connect(file, timeout=0.0, isolation_level=None)
        try:
            with self._errors():
                self._open()
        except BaseException:
            self._database.close()
            raise

    def _open(self) -> None:
        self._database.execute("PRAGMA locking_mode=EXCLUSIVE")
        if self._database.execute("PRAGMA journal_mode=WAL").fetchone() != ("wal",):
            raise FormatError(str(self.file), "a write-ahead log is not possible there")
        self._database.execute("PRAGMA synchronous=FULL")
        self._database.execute("BEGIN IMMEDIATE")  # takes the lock, which is then kept
        self._database.execute("COMMIT")
        problems = self._database.execute("PRAGMA quick_check(1)").fetchone()
        if problems != ("ok",):
            raise FormatError(str(self.file), f"damaged: {problems[0]}")
        tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
        self.begun = bool(tables)
        """Whether there is a sweep in it."""
        if self.begun and tables != {"about", "chunks"}:
            raise FormatError(str(self.file), "a database, but no journal of a sweep")
        if self.begun and (self._about("schema"), self._about("version")) != (_SCHEMA, _VERSION):
            found = f"{self._about('schema')} version {self._about('version')}"
            raise FormatError(str(self.file), f"{found}; this version reads {_SCHEMA} version {_VERSION}")
        if self.begun and self._about("sha256") != _checksum(self._about("about")):
            raise FormatError(str(self.file), "damaged: what the sweep is about does not fit its checksum")

    def __enter__(self) -> SweepJournal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._database.close()

    def begin(self, about: Mapping[str, Any]) -> None:
        """Begin a sweep: what it is about can be asked for ever after, and never changes."""
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
        """What the sweep is about, as it was begun."""
        with self._errors():
            return self._about("about")

    def record(self, outcome: ChunkOutcome) -> None:
        """Write down how a chunk ended. A chunk that is done cannot be done again; one that failed can.

        Raises:
            ValueError: If the chunk is done already.
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
                raise ValueError(f"{chunk.name} is done already") from None

    def done(self) -> set[int]:
        """Return the indices of the chunks that are done."""
        with self._errors():
            return {index for (index,) in self._database.execute("SELECT id FROM chunks WHERE rows IS NOT NULL")}

    def errors(self) -> dict[int, str]:
        """Return what went wrong in the chunks that failed, by index."""
        with self._errors():
            found = self._database.execute("SELECT id, error FROM chunks WHERE rows IS NULL ORDER BY id")
            return dict(found.fetchall())

    def rows(self, chunk: Chunk) -> Rows:
        """Return the rows of a chunk that is done.

        Raises:
            KeyError: If it is not.
        """
        with self._errors():
            found = self._database.execute("SELECT rows FROM chunks WHERE id = ?", (chunk.index,)).fetchone()
            if found is None or found[0] is None:
                raise KeyError(chunk.name)
            return json.loads(zlib.decompress(found[0]))

    def _about(self, key: str) -> Any:
        found = self._database.execute("SELECT value FROM about WHERE key = ?", (key,)).fetchone()
        return None if found is None else json.loads(found[0])

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
        """Turn what SQLite and the decoders say about a bad file into a FormatError that names it."""
        try:
            yield
        except sqlite3.OperationalError as error:
            # What Python itself finds wrong has no code.
            if getattr(error, "sqlite_errorcode", None) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                raise SweepBusy(self.file) from None
            raise FormatError(str(self.file), f"cannot be used: {error}") from None
        except OSError as error:
            raise FormatError(str(self.file), why_not_read(error)) from None
        except (sqlite3.DatabaseError, zlib.error, json.JSONDecodeError, UnicodeDecodeError) as error:
            raise FormatError(str(self.file), f"damaged, or no journal of a sweep: {error}") from None

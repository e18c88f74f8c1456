"""Journal of a comparison: an append-only file of JSON lines.

The first line contains the settings and the machine; every other line is a run. Each line is written at once and synced
to disk, so a kill loses at most the runs in progress. An incomplete last line is truncated when the journal is opened
again; any other damage is refused.
"""

from __future__ import annotations

import fcntl
import json
import os
import sys
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from graceful_plan.compare.runs.records import Run
from graceful_plan.exceptions import READ_ERRORS, FormatError, GracefulPlanError, read_error_reason
from graceful_plan.regular_file import check_regular, read_content
from graceful_plan.untrusted_json import parse_json

NAME = "journal.jsonl"
VERSION = 3
"""Version of the journal, increased when a field of a run is added, removed or changes its meaning."""
_SCHEMA = {"schema": "graceful_plan.bench", "version": VERSION}
_SETTINGS = {
    "suite": str,
    "problems": [{"name": str, "group": str}],
    "planners": [{"label": str}],
    "seeds": [int],
    "seconds": float,
    "w": float,
}
"""Required settings with their types; a list stands for a list of such items."""


class OtherSettings(GracefulPlanError, ValueError):
    """A folder contains a comparison with other settings."""

    def __init__(self, folder: Path, differences: tuple[str, ...]) -> None:
        self.folder, self.differences = folder, differences
        super().__init__(
            f"{folder} holds a comparison made with other settings: {'; '.join(differences)}. "
            "Repeat those to resume it, or choose another folder."
        )


class RunJournalBusy(GracefulPlanError, RuntimeError):
    """Another process is writing the journal."""

    def __init__(self, file: Path) -> None:
        self.file = file
        super().__init__(f"{file} is in use by another process")


class RunJournal:
    """An open journal, created if missing. Use it in a `with` statement.

    Args:
        folder: Folder of the journal.
        settings: Settings of the comparison; must equal those in an existing journal.
        machine: Description of the machine.
        known: Best-known total costs in the suite, by problem.

    Raises:
        FormatError: If the file is not a journal, or damaged other than at its end.
        OtherSettings: If it was begun with other settings.
        RunJournalBusy: If another process has it open.
    """

    def __init__(
        self,
        folder: Path,
        settings: Mapping[str, Any],
        machine: Mapping[str, str],
        known: Mapping[str, float] | None = None,
    ) -> None:
        self.file = folder / NAME
        folder.mkdir(parents=True, exist_ok=True)
        try:
            check_regular(self.file)
        except READ_ERRORS as error:
            raise FormatError(str(self.file), read_error_reason(error)) from None
        self._stream = self.file.open("ab+")
        try:
            self._lock()
            self._cut()
            if self.file.stat().st_size == 0:
                begun = datetime.now(UTC).isoformat(sep=" ", timespec="seconds")
                about = {"begun": begun, "settings": settings, "machine": machine, "known": dict(known or {})}
                self._append(json.dumps({**_SCHEMA, **about}, allow_nan=False))
            self.head, self.runs = read(self.file)
            self._check(self.head, settings)
        except BaseException:
            self._stream.close()
            raise

    def _lock(self) -> None:
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunJournalBusy(self.file) from None

    def _cut(self) -> None:
        """Truncate an incomplete last line; leave a file that is not a journal unchanged."""
        self._stream.seek(0)
        content = self._stream.read()
        begin = json.dumps(_SCHEMA).encode().split(b",")[0]
        if content[: len(begin)] != begin[: len(content)]:
            raise FormatError(str(self.file), "no journal of a comparison")
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            self._stream.truncate(whole)

    def _check(self, head: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
        there, here = head["settings"], json.loads(json.dumps(settings))
        key = "version of the journal"
        found = (*differences({key: head["version"]}, {key: VERSION}), *differences(there, here))
        if found:
            raise OtherSettings(self.file.parent, found)

    def __enter__(self) -> RunJournal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stream.close()

    def add(self, run: Run) -> None:
        """Append a run; it is on disk when this returns."""
        self._append(run.to_json())
        self.runs.append(run)

    def _append(self, line: str) -> None:
        self._stream.write(line.encode() + b"\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())


def read(file: Path) -> tuple[dict[str, Any], list[Run]]:
    """Read the first line and the runs of a journal, without an incomplete last line.

    Fields that earlier versions did not record count as not measured.

    Raises:
        FormatError: If the file is not a journal, of an unsupported version, or damaged.
    """
    try:
        content = read_content(file)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    lines = content.split(b"\n")[:-1]
    if not lines:
        raise FormatError(str(file), "no journal of a comparison: it has no first line")
    head = _document(lines[0], f"{file}:1")
    if not isinstance(head, dict) or head.get("schema") != _SCHEMA["schema"]:
        raise FormatError(str(file), "no journal of a comparison")
    version = head.get("version")
    if type(version) is not int or not 1 <= version <= VERSION:
        raise FormatError(str(file), f"version {version!r}; this version reads 1 to {VERSION}")
    if version == 1:
        head = {"begun": "", "known": {}, **head}  # missing in the first version
    kinds = {"begun": str, "settings": dict, "machine": dict, "known": dict}
    for key, kind in kinds.items():
        if not isinstance(head.get(key), kind):
            raise FormatError(f"{file}:1", f"damaged: no {key}")
    runs: dict[tuple[str, str, int], Run] = {}
    for number, line in enumerate(lines[1:], 2):
        where = f"{file}:{number}"
        run = Run.from_document(_document(line, where), where, complete=version == VERSION)
        runs[run.key] = run
    return head, list(runs.values())


def check_head(head: Mapping[str, Any], file: Path) -> None:
    """Raise FormatError if the first line of a journal lacks a field needed for reports."""
    if missing := next(_lacks(head["settings"], _SETTINGS), None):
        raise FormatError(f"{file}:1", f"damaged: settings have no {missing}")
    if not all(map(_is_number, head["known"].values())):
        raise FormatError(f"{file}:1", "damaged: known costs have to be numbers")


def _lacks(document: Any, shape: Any, name: str = "") -> Iterator[str]:
    """Yield the names of fields that a document lacks: types by key, and in lists the shape of each item."""
    if isinstance(shape, Mapping):
        for key, inside in shape.items():
            there = document.get(key) if isinstance(document, Mapping) else None
            yield from _lacks(there, inside, f"{name}.{key}" if name else key)
    elif isinstance(shape, list):
        for i, item in enumerate(document if isinstance(document, list) and document else [None]):
            yield from _lacks(item, shape[0], f"{name}[{i}]")
    elif not (_is_number(document) if shape is float else isinstance(document, shape)):
        yield name


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _document(line: bytes, where: str) -> Any:
    return parse_json(line, where)


def differences(there: Any, here: Any, name: str = "") -> Iterator[str]:
    """Yield descriptions of the differences of two documents."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        for key in [*there, *(key for key in here if key not in there)]:
            yield from differences(there.get(key), here.get(key), f"{name}.{key}" if name else str(key))
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for i, (a, b) in enumerate(zip(there, here, strict=True)):
            yield from differences(a, b, f"{name}[{i}]")
    elif there != here:
        yield f"{name} was {_short(there)} and is {_short(here)}"


def _short(value: Any) -> str:
    if isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        value = [item.get("label") or item.get("name") for item in value]
    text = json.dumps(value)
    return text if len(text) <= 120 else f"{text[:117]}..."

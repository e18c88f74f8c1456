"""The samples of a timed motion, common to all formats, and their units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import READ_ERRORS, FormatError, read_error_reason
from graceful_plan.regular_file import MOST_BYTES, path_of, read_content

UNITS = {"t": "s", "q": "rad or m", "qd": "rad/s or m/s", "qdd": "rad/s^2 or m/s^2"}
SCHEMA, VERSION = "graceful_plan.trajectory", 1


class TimedSamples(NamedTuple):
    """The fields of a `Trajectory`, unchecked."""

    t: Float[Array, " time"]
    q: Float[Array, "time nq"]
    qd: Float[Array, "time nq"]
    qdd: Float[Array, "time nq"]
    joints: tuple[str, ...]

    @property
    def columns(self) -> dict[str, Float[Array, " time"]]:
        """All columns of a table of these samples, by name: "t", "q shoulder", "qd shoulder", .."""
        tables = {"q": self.q, "qd": self.qd, "qdd": self.qdd}
        named = {f"{key} {joint}": table[:, i] for key, table in tables.items() for i, joint in enumerate(self.joints)}
        return {"t": self.t, **named}


def from_columns(source: str, names: list[str], table: Float[Array, "time column"]) -> TimedSamples:
    """Return the samples of a table whose columns have the names and order of `TimedSamples.columns`.

    Raises:
        FormatError: If the table has other columns.
    """
    count, rest = divmod(len(names) - 1, 3)
    joints = tuple(name.removeprefix("q ") for name in names[1 : 1 + count])
    expected = ["t", *(f"{key} {joint}" for key in ("q", "qd", "qdd") for joint in joints)]
    if not names or rest or names != expected:
        found = ", ".join(names[:8]) + (", .." if len(names) > 8 else "")
        raise FormatError(source, f"the columns have to be t, then q, qd and qdd of every joint; found: {found}")
    q, qd, qdd = (table[:, 1 + i * count : 1 + (i + 1) * count] for i in range(3))
    return TimedSamples(table[:, 0], q, qd, qdd, joints)


def text_of(source: str | Path, is_text: Callable[[str], bool], kind: str, most: int = MOST_BYTES) -> tuple[str, str]:
    """Return the label of a source in errors, and its text.

    Args:
        source: A file, or the text itself.
        is_text: Returns whether a string is the text itself rather than a file name.
        kind: Name of the format for messages, such as "JSON".
        most: Largest size of a file or text [bytes].

    Raises:
        FormatError: If the file cannot be read, is not text, or is too large.
    """
    if isinstance(source, str) and is_text(source):
        if len(source) > most:
            raise FormatError(f"{kind} text", f"{len(source)} characters, at most {most} are read")
        return f"{kind} text", source
    path = path_of(source)
    try:
        content = read_content(path, most)
    except READ_ERRORS as error:
        raise FormatError(str(source), read_error_reason(error)) from None
    try:
        return str(source), content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(str(source), f"not {kind}: {error}") from None

"""Files of strangers are opened here: regular ones alone, so that no reader waits, and no longer than they were.

A named pipe would wait for somebody who writes, a device may have no end, and either of them can stand where a file is
expected, also as what a link leads to.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from graceful_plan.exceptions import FormatError

MOST_BYTES = 2**30
"""What is read of a file at most, where a reader does not say less."""
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_BINARY", "O_CLOEXEC"))
"""Not blocking, since a named pipe waits where it is opened already."""
_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def path_of(file: object) -> Path:
    """Return what was given as the name of a file or folder as a path.

    Raises:
        FormatError: If it is neither text nor a path, or the system has no such names.
    """
    if not isinstance(file, str | os.PathLike) or isinstance(named := os.fspath(file), bytes):
        raise FormatError(f"{file!r:.100}", f"no name of a file, but of type {type(file).__name__}")
    path = Path(named)
    try:
        path.exists()
    except OSError as error:  # a name that is too long, above all
        raise FormatError(f"{file!r:.100}", f"cannot be read: {error.strerror}") from None
    return path


def open_regular(file: str | Path) -> BinaryIO:
    """Open a regular file to read its bytes.

    Raises:
        OSError: If it is not there, not allowed, or something else than a regular file.
        ValueError: If no file can have that name.
    """
    descriptor = os.open(file, _FLAGS)
    try:
        _check_kind(os.fstat(descriptor).st_mode)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def check_regular(file: str | Path) -> None:
    """Refuse what cannot be opened as a file by somebody else, such as SQLite; one that is not there yet can.

    Raises:
        OSError: If it is there and no regular file.
        ValueError: If no file can have that name.
    """
    try:
        _check_kind(os.stat(file).st_mode)
    except FileNotFoundError:
        return


def _check_kind(mode: int) -> None:
    kind = stat.S_IFMT(mode)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if kind != stat.S_IFREG:
        raise OSError(errno.EINVAL, f"{_KINDS.get(kind, 'something')} is no regular file")


def read_content(file: str | Path, most: int = MOST_BYTES) -> bytes:
    """Return the bytes of a regular file.

    Raises:
        OSError: As `open_regular`, and if it has more bytes than `most`.
        ValueError: As `open_regular`.
    """
    with open_regular(file) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > most:
            raise OSError(errno.EFBIG, f"{size} bytes, at most {most} are read")
        return stream.read(size)

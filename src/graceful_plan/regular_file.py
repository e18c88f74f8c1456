"""Open untrusted files: regular files only, size-capped.

A file name may be, or link to, a named pipe or a device. Reading a pipe blocks until another process writes to it, and
a device may never end.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from graceful_plan.exceptions import FormatError

MOST_BYTES = 2**30
"""Default limit of a file's size [bytes]."""
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_BINARY", "O_CLOEXEC"))
"""Includes O_NONBLOCK, since opening a named pipe already blocks."""
_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def path_of(file: object) -> Path:
    """Convert the name of a file or folder to a path.

    Raises:
        FormatError: If the argument is neither text nor a path, or the system does not support the name.
    """
    if not isinstance(file, str | os.PathLike) or isinstance(named := os.fspath(file), bytes):
        raise FormatError(f"{file!r:.100}", f"not the name of a file, but of type {type(file).__name__}")
    path = Path(named)
    try:
        path.exists()
    except OSError as error:  # mostly names that are too long
        raise FormatError(f"{file!r:.100}", f"cannot be read: {error.strerror}") from None
    return path


def open_regular(file: str | Path) -> BinaryIO:
    """Open a regular file to read its bytes.

    Raises:
        OSError: If it does not exist, may not be read, or is not a regular file.
        ValueError: If the name is not valid.
    """
    descriptor = os.open(file, _FLAGS)
    try:
        _check_kind(os.fstat(descriptor).st_mode)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def check_regular(file: str | Path) -> None:
    """Refuse names that are not regular files, before another library, such as SQLite, opens them.

    Missing files are accepted, since the library may create them.

    Raises:
        OSError: If the name exists and is not a regular file.
        ValueError: If the name is not valid.
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
        raise OSError(errno.EINVAL, f"{_KINDS.get(kind, 'something')} is not a regular file")


def read_content(file: str | Path, most: int = MOST_BYTES) -> bytes:
    """Return the bytes of a regular file.

    Raises:
        OSError: As for `open_regular`, and if the file has more than `most` bytes.
        ValueError: As for `open_regular`.
    """
    with open_regular(file) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > most:
            raise OSError(errno.EFBIG, f"{size} bytes, at most {most} are read")
        return stream.read(size)

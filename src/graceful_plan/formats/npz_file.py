"""Arrays from untrusted .npz files: their declared size is checked before any array is allocated."""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from graceful_plan.array_types import Array
from graceful_plan.exceptions import READ_ERRORS, FormatError, read_error_reason
from graceful_plan.regular_file import open_regular, path_of

MOST_BYTES = 2**30
"""Largest total size of the arrays of a file [bytes]."""
_KINDS = "biufSU"
"""Types of arrays that are read: truth values, real numbers and texts."""
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_BROKEN = (
    *READ_ERRORS,
    KeyError,
    EOFError,
    TypeError,
    SyntaxError,  # with TokenError: a header that is not Python
    tokenize.TokenError,
    RuntimeError,  # deep nesting, encryption
    MemoryError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_arrays(file: str | Path, most_bytes: int = MOST_BYTES) -> dict[str, Array]:
    """Read the arrays of an .npz file by name. No code in the file is executed.

    Raises:
        FormatError: If the file is missing or broken, declares more than `most_bytes`, or contains anything but arrays
            of numbers and texts.
    """
    path = path_of(file)
    try:
        opened = open_regular(path)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    try:
        with opened, zipfile.ZipFile(opened) as archive:
            needed = sum(_size(archive, member) for member in archive.infolist())
            if needed > most_bytes:
                raise FormatError(str(file), f"holds {needed} bytes of arrays; at most {most_bytes} are read")
            opened.seek(0)
            with np.load(opened, allow_pickle=False) as found:
                return {name: found[name] for name in found.files}
    except _BROKEN as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(str(file), f"is no .npz file of arrays: {error}") from None


def _size(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """Return the size of an array by its header [bytes]; raise if the member is smaller."""
    with archive.open(member) as content:
        head: IO[Any] = content
        shape, _, dtype = _HEADERS[npy.read_magic(head)](head)
        size = math.prod(shape) * dtype.itemsize
        if dtype.kind not in _KINDS:
            raise ValueError(f"{member.filename} has values of type {dtype}")
        if min(shape, default=0) < 0 or size > member.file_size:
            raise ValueError(f"{member.filename} has {member.file_size} bytes for {dtype} {shape}")
        return size

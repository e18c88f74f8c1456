"""Read untrusted grey images: sizes are checked before memory is allocated, and malformed files are rejected."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graceful_plan.array_types import Array, Bool, Int
from graceful_plan.exceptions import READ_ERRORS, FormatError, read_error_reason
from graceful_plan.regular_file import read_content

_TOKEN = re.compile(rb"(?:\s|#[^\n]*\n)*(\d{1,10})(?![0-9])")
"""A number in the header of a PGM, after white space and comments."""
_MOST_HEAD = 4096
"""Largest size of the header, including comments [bytes]."""


@dataclass(frozen=True, eq=False)
class GreyPicture:
    """A grey image, the uppermost row first.

    Args:
        grey: Pixel values from 0 to `most`.
        most: Value of white.
        transparent: Mask of pixels that are not opaque; None if the image has no alpha channel.
    """

    grey: Int[Array, "row column"]
    most: int
    transparent: Bool[Array, "row column"] | None = None


def read_picture(file: Path, most_pixels: int) -> GreyPicture:
    """Read a PGM, plain or binary, or a PNG.

    Raises:
        FormatError: If the file is missing, broken, truncated or too large.
    """
    try:
        # A pixel takes at most five digits and a space in a plain PGM, and two bytes in a binary one; a PNG is
        # compressed.
        content = read_content(file, 6 * most_pixels + _MOST_HEAD)
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    read = _read_png if content.startswith(b"\x89PNG\r\n\x1a\n") else _read_pgm
    return read(file, content, most_pixels)


def _read_pgm(file: Path, content: bytes, most_pixels: int) -> GreyPicture:
    head = content[:_MOST_HEAD]
    if head[:2] not in (b"P2", b"P5"):
        raise FormatError(str(file), "is neither a PGM (P2, P5) nor a PNG")
    numbers, at = [], 2
    for what in ("width", "height", "greatest value"):
        match = _TOKEN.match(head, at)
        if match is None:
            raise FormatError(str(file), f"the head of this PGM has no {what}")
        numbers.append(int(match[1]))
        at = match.end()
    width, height, most = numbers
    if not (width > 0 and height > 0 and width * height <= most_pixels):
        raise FormatError(str(file), f"{width} x {height} pixels; from 1 to {most_pixels} are read")
    if not 0 < most < 65536:
        raise FormatError(str(file), f"its greatest value is {most}, expected 1 to 65535")
    found = _plain(file, content[at:]) if head[:2] == b"P2" else _binary(content[at + 1 :], most)
    if found.size < width * height:
        raise FormatError(str(file), f"is truncated: {found.size} of {width * height} pixels")
    grey = found[: width * height].reshape(height, width)
    if grey.max() > most:
        raise FormatError(str(file), f"a pixel of {int(grey.max())} is above the greatest value {most}")
    return GreyPicture(grey, most)


def _binary(content: bytes, most: int) -> Int[Array, " pixel"]:
    kind = np.dtype(np.uint8) if most < 256 else np.dtype(">u2")
    whole = content[: len(content) - len(content) % kind.itemsize]
    return np.frombuffer(whole, dtype=kind).astype(np.int32)


def _plain(file: Path, content: bytes) -> Int[Array, " pixel"]:
    if re.search(rb"[^0-9\s]|[0-9]{6}", content):
        raise FormatError(str(file), "the pixels of this plain PGM are not whole numbers of at most 5 digits")
    return np.fromstring(content, dtype=np.int32, sep=" ")


def _read_png(file: Path, content: bytes, most_pixels: int) -> GreyPicture:
    width, height = (int.from_bytes(content[k : k + 4], "big") for k in (16, 20))
    if len(content) < 33 or not (width > 0 and height > 0 and width * height <= most_pixels):
        raise FormatError(str(file), f"{width} x {height} pixels; from 1 to {most_pixels} are read")
    from PIL import Image  # comes with matplotlib; importing the library must not import it

    try:
        with Image.open(io.BytesIO(content), formats=("PNG",)) as image:
            clear = np.asarray(image.getchannel("A")) < 255 if "A" in image.getbands() else None
            grey = np.asarray(image.convert("L"), dtype=np.int32)
    except (*READ_ERRORS, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        raise FormatError(str(file), f"is a broken PNG: {error}") from None
    return GreyPicture(grey, 255, clear)

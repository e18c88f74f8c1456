"""What MuJoCo would make of a file of a model, before it does: by headers and counts, with bounded memory and time.

A PNG says in its header how many pixels there are, but its data may unpack to a thousand times its size, and MuJoCo
would unpack all of it. So it is unpacked here first, in pieces that are thrown away.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PACKED_TEXTS = (b"zTXt", b"iTXt", b"iCCP")
_MOST_TEXTS = 8
"""Chunks of a PNG that unpack to 16 MB each at most and are no pixels; pictures have one or two."""
_PIECE = 1 << 20
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Of a pixel, by a PNG's colour type."""
_OBJ_LINE = re.compile(rb"[\r\n][ \t]*[vf][ \t]")
_STL_FACE = 50


class Swollen(ValueError):
    """A file that unpacks to more than its header says."""


def weighed(tag: str, content: bytes, suffix: str) -> tuple[str, int | float] | None:
    """Return what a file adds to which budget of a model; None for what weighs nothing.

    Args:
        tag: Of the element that names the file.
        content: Of the file.
        suffix: Of its name.

    """
    if tag in ("texture", "hfield"):
        pixels = _png_pixels(content) if content.startswith(_SIGNATURE) else len(content)
        return "pixels of textures" if tag == "texture" else "cells of height fields", pixels
    if tag != "mesh":
        return None
    count = sum(1 for _ in _OBJ_LINE.finditer(content)) if suffix.lower() == ".obj" else len(content) / _STL_FACE
    return "vertices and faces of meshes", count


def _png_pixels(content: bytes) -> int:
    """Return how many pixels a PNG has, without looking at its data."""
    width, height = (int.from_bytes(content[k : k + 4], "big") for k in (16, 20))
    return width * height


def check_png(file: Path, content: bytes) -> None:
    """Refuse a PNG whose data unpack to more than the pixels that it says it has.

    Raises:
        Swollen: If they do.
    """
    if not content.startswith(_SIGNATURE) or len(content) < 26:
        return
    width, height = (int.from_bytes(content[k : k + 4], "big") for k in (16, 20))
    bits = content[24] * _CHANNELS.get(content[25], 4)
    most = 2 * height * (1 + (width * bits + 7) // 8) + _PIECE  # an interlaced one has more rows, of fewer pixels
    unpacked, texts, unpack = 0, 0, zlib.decompressobj()
    for kind, data in _chunks(content):
        texts += kind in _PACKED_TEXTS
        while kind == b"IDAT" and data and not unpack.eof:
            try:
                unpacked += len(unpack.decompress(data, _PIECE))
            except zlib.error:
                return  # MuJoCo says it better
            data = unpack.unconsumed_tail
            if unpacked > most:
                raise Swollen(f"{file.name} unpacks to more than {width} x {height} pixels")
    if texts > _MOST_TEXTS:
        raise Swollen(f"{file.name} holds {texts} packed texts, at most {_MOST_TEXTS} are read")


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and data of a PNG's chunks."""
    place = len(_SIGNATURE)
    while place + 8 <= len(content):
        length = int.from_bytes(content[place : place + 4], "big")
        yield content[place + 4 : place + 8], content[place + 8 : place + 8 + length]
        place += 12 + length

"""What MuJoCo would make of a file of a model, before it does: by headers and counts, with bounded memory and time.

A PNG says in its header how many pixels there are, but its data may unpack to a thousand times its size, and MuJoCo
would unpack all of it. So it is unpacked here first, in pieces that are thrown away.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PACKED_TEXTS = (b"zTXt", b"iTXt", b"iCCP")
_MOST_TEXTS = 8
"""Chunks of a PNG that unpack to 16 MB each at most and are no pixels; pictures have one or two."""
_PIECE = 1 << 20
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Of a pixel, by a PNG's colour type."""
_OBJ_LINE = re.compile(rb"[\r\n][ \t]*[vf][ \t]")
_STL_HEAD, _STL_FACE = 84, 50
_VERTEX = 12
"""Bytes of a vertex where it is three numbers of single precision."""
_MIXED = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)
"""Odd numbers of 64 bits: three coordinates times these are a number that hardly any other corner has."""
MOST_OF_A_MESH = 1_000_000
"""Vertices and faces in one file: a hull around 300,000 vertices on a sphere takes MuJoCo 4 s, around a million 12."""


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
    return "vertices and faces of meshes", mesh_weight(content, suffix)


def mesh_weight(content: bytes, suffix: str) -> int:
    """Return how many vertices and faces a mesh has, those of a binary STL that are at one place counted once."""
    if suffix.lower() == ".obj":
        return sum(1 for _ in _OBJ_LINE.finditer(content))
    if suffix.lower() != ".stl":
        return len(content) // _VERTEX
    faces = max(0, len(content) - _STL_HEAD) // _STL_FACE
    records = np.frombuffer(content, np.uint8, faces * _STL_FACE, min(_STL_HEAD, len(content))).reshape(-1, _STL_FACE)
    corners = np.ascontiguousarray(records[:, 12:48]).view("<u4").reshape(-1, 3).astype(np.uint64)
    return faces + len(np.unique(corners @ np.array(_MIXED, dtype=np.uint64)))


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

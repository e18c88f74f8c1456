"""Size checks of asset files before MuJoCo loads them, by headers and counts, in bounded memory and time.

The header of a PNG states its number of pixels, but its data may decompress to a thousand times that size, all of
which MuJoCo would allocate. Therefore it is decompressed here first, in pieces that are discarded.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

PIXELS = "pixels of textures"
"""Budget of a model that textures count towards."""
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PACKED_TEXTS = (b"zTXt", b"iTXt", b"iCCP")
_MOST_TEXTS = 8
"""Number of compressed text chunks in a PNG, of up to 16 MB each when decompressed; images have one or two."""
_PIECE = 1 << 20
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Channels per pixel, by a PNG's colour type."""
_OBJ_LINE = re.compile(rb"[\r\n][ \t]*[vf][ \t]")
_STL_HEAD, _STL_FACE = 84, 50
_MSH_HEAD = 16
"""Bytes of the head of MuJoCo's own format: numbers of vertices, normals, texture coordinates and faces."""
_VERTEX = 12
"""Bytes of a vertex of three single-precision numbers, and of a face of three indices."""
_MIXED = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)
"""Odd 64-bit factors that hash the three coordinates of a vertex, with hardly any collisions."""
MOST_OF_A_MESH = 1_000_000
"""Vertices and faces per file: MuJoCo takes 4 s for the hull of 300,000 vertices on a sphere, 12 s for a million."""


class DecompressionError(ValueError):
    """Raised if a file decompresses to more than its header states."""


def asset_budget(tag: str, content: bytes, suffix: str) -> tuple[str, int | float] | None:
    """Return the budget of the model that a file counts towards and the amount; None if it counts towards none.

    Args:
        tag: Tag of the element that names the file.
        content: Content of the file.
        suffix: Suffix of its name.
    """
    if tag in ("texture", "hfield"):
        pixels = _png_pixels(content) if content.startswith(_SIGNATURE) else len(content)
        return PIXELS if tag == "texture" else "cells of height fields", pixels
    if tag != "mesh":
        return None
    return "vertices and faces of meshes", mesh_weight(content, suffix)


def mesh_weight(content: bytes, suffix: str) -> int:
    """Return the number of vertices and faces of a mesh; coincident vertices of a binary STL are counted once."""
    if suffix.lower() == ".obj":
        return sum(1 for _ in _OBJ_LINE.finditer(content))
    if suffix.lower() == ".msh":
        vertices, _, _, faces = np.frombuffer(content[:_MSH_HEAD].ljust(_MSH_HEAD, b"\0"), "<i4").tolist()
        return min(max(vertices, 0), len(content) // _VERTEX) + min(max(faces, 0), len(content) // _VERTEX)
    if suffix.lower() != ".stl":
        return len(content) // _VERTEX
    faces = max(0, len(content) - _STL_HEAD) // _STL_FACE
    records = np.frombuffer(content, np.uint8, faces * _STL_FACE, min(_STL_HEAD, len(content))).reshape(-1, _STL_FACE)
    corners = np.ascontiguousarray(records[:, 12:48]).view("<u4").reshape(-1, 3).astype(np.uint64)
    return faces + len(np.unique(corners @ np.array(_MIXED, dtype=np.uint64)))


def _png_pixels(content: bytes) -> int:
    """Return the number of pixels of a PNG by its header."""
    width, height = (int.from_bytes(content[k : k + 4], "big") for k in (16, 20))
    return width * height


def check_png(file: Path, content: bytes) -> None:
    """Check that the data of a PNG decompress to no more than the pixels its header states.

    Raises:
        DecompressionError: If they decompress to more.
    """
    if not content.startswith(_SIGNATURE) or len(content) < 26:
        return
    width, height = (int.from_bytes(content[k : k + 4], "big") for k in (16, 20))
    bits = content[24] * _CHANNELS.get(content[25], 4)
    most = 2 * height * (1 + (width * bits + 7) // 8) + _PIECE  # interlaced: more but shorter rows
    unpacked, texts, unpack = 0, 0, zlib.decompressobj()
    for kind, data in _chunks(content):
        texts += kind in _PACKED_TEXTS
        while kind == b"IDAT" and data and not unpack.eof:
            try:
                unpacked += len(unpack.decompress(data, _PIECE))
            except zlib.error:
                return  # MuJoCo's own error is better
            data = unpack.unconsumed_tail
            if unpacked > most:
                raise DecompressionError(f"{file.name} unpacks to more than {width} x {height} pixels")
    if texts > _MOST_TEXTS:
        raise DecompressionError(f"{file.name} holds {texts} packed texts, at most {_MOST_TEXTS} are read")


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and data of each chunk of a PNG."""
    place = len(_SIGNATURE)
    while place + 8 <= len(content):
        length = int.from_bytes(content[place : place + 4], "big")
        yield content[place + 4 : place + 8], content[place + 8 : place + 8 + length]
        place += 12 + length

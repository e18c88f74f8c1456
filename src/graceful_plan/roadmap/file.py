"""Roadmaps in files: arrays in an npz archive without pickled objects, written whole or not at all.

A file holds no scene and no objective, only their hashes: whoever reads it brings both, and a file that was made for
others is refused.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from pathlib import Path as FilePath
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import FormatError, GracefulPlanError
from graceful_plan.planners.roadmaps.edge_prices import EdgePrices, Edges
from graceful_plan.roadmap.fingerprint import Fingerprint, differences

Array = np.ndarray

SCHEMA = "graceful_plan.roadmap"
VERSION = 1
_ARRAYS = {"q": "f8", "tail": "i4", "head": "i4", "motion": "f8", "edge": "i4", "column": "i4", "exposure": "f8"}
_HEADER = "header"
_MOST = 4 << 30
"""Bytes beyond which no file is read."""


class StaleRoadmapError(GracefulPlanError, ValueError):
    """A roadmap of another scene or another objective.

    Args:
        source: Where it comes from.
        parts: What differs.
    """

    def __init__(self, source: str, parts: list[str]) -> None:
        self.source, self.parts = source, tuple(parts)
        super().__init__(f"{source} was built with another {', another '.join(parts)}; build it again")


def write(file: str | FilePath, q: Float[Array, "node nq"], edges: Edges, columns: int, made_for: Fingerprint) -> None:
    """Write a roadmap.

    Raises:
        OSError: If that is not possible; the file is then as it was before.
    """
    file = FilePath(file)
    prices = edges.prices
    values = (q, edges.tail, edges.head, prices.motion, prices.edge, prices.column, prices.exposure)
    arrays = {name: np.asarray(value, dtype=kind) for (name, kind), value in zip(_ARRAYS.items(), values, strict=True)}
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "columns": columns,
        "fingerprint": made_for,
        "arrays": _checksum(arrays),
    }
    text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    with NamedTemporaryFile(dir=file.parent, prefix=f".{file.name}.", suffix=".partial", delete=False) as partial:
        try:
            np.savez(partial, **{_HEADER: text}, **arrays, allow_pickle=False)
            partial.flush()
            os.fsync(partial.fileno())
            partial.close()
            FilePath(partial.name).replace(file)
        except BaseException:
            FilePath(partial.name).unlink(missing_ok=True)
            raise


def read(file: str | FilePath, made_for: Fingerprint, columns: int, nq: int) -> tuple[Float[Array, "node nq"], Edges]:
    """Read a roadmap.

    Args:
        file: Where it is.
        made_for: What it has to have been built for.
        columns: Number of columns of its exposures.
        nq: Number of joints.

    Raises:
        StaleRoadmapError: If it was built for something else.
        FormatError: If the file is not a roadmap, is damaged, or of another version of the format.
        OSError: If it cannot be read at all.
    """
    source = str(file)
    try:
        contents = _contents(FilePath(file))
        header = json.loads(contents.pop(_HEADER).tobytes().decode())
        if header.get("schema") != SCHEMA:
            raise FormatError(source, "not a roadmap")
        if header.get("version") != VERSION:
            raise FormatError(source, f"format {header.get('version')!r}, this library reads {VERSION}; build it again")
        if parts := differences(header["fingerprint"], made_for):
            raise StaleRoadmapError(source, parts)
        if header["arrays"] != _checksum(contents):
            raise FormatError(source, "damaged: the contents are not those that were written")
        return _checked(source, contents, header["columns"], columns, nq)
    except (zipfile.BadZipFile, ValueError, KeyError, TypeError, AttributeError, EOFError, MemoryError) as error:
        if isinstance(error, GracefulPlanError):
            raise
        raise FormatError(source, f"damaged or not a roadmap ({type(error).__name__}: {error})") from error


def _contents(file: FilePath) -> dict[str, Array]:
    """Arrays of an archive that says nothing about their size that is not true."""
    size = file.stat().st_size
    if size > _MOST:
        raise FormatError(str(file), f"{size} bytes; roadmaps have at most {_MOST}")
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        if {m.filename for m in members} != {f"{name}.npy" for name in (_HEADER, *_ARRAYS)} or len(members) > 8:
            raise FormatError(str(file), "not a roadmap")
        if any(m.compress_type != zipfile.ZIP_STORED or m.file_size > size for m in members):
            raise FormatError(str(file), "not a roadmap: it is compressed")
    with np.load(file, allow_pickle=False) as data:
        return {name: data[name] for name in (_HEADER, *_ARRAYS)}


def _checked(source: str, arrays: dict[str, Array], stored: Any, columns: int, nq: int) -> tuple[Array, Edges]:
    """Refuse arrays that cannot be those of a roadmap: what is read here is searched by native code."""
    q, tail, head, motion, edge, column, exposure = (arrays[name] for name in _ARRAYS)
    n, m = len(q), len(tail)
    right = [
        stored == columns,
        all(arrays[name].dtype == np.dtype(kind) for name, kind in _ARRAYS.items()),
        q.ndim == 2 and q.shape[1] == nq,
        tail.shape == head.shape == motion.shape == (m,),
        edge.shape == column.shape == exposure.shape == (len(edge),),
    ]
    if not all(right):
        raise FormatError(source, "damaged: arrays of the wrong shape")
    inside = [(tail, n), (head, n), (edge, m), (column, columns)]
    finite = all(np.isfinite(a).all() for a in (q, motion, exposure))
    if not (
        finite
        and all(len(a) == 0 or (a.min() >= 0 and a.max() < most) for a, most in inside)
        and (motion >= 0.0).all()
        and (exposure >= 0.0).all()
    ):
        raise FormatError(source, "damaged: numbers outside of their range")
    return q, Edges(tail, head, EdgePrices(motion, edge, column, exposure))


def _checksum(arrays: dict[str, Array]) -> str:
    digest = hashlib.sha256()
    for name in _ARRAYS:
        digest.update(f"{name}{arrays[name].shape}{arrays[name].dtype}".encode() + arrays[name].tobytes())
    return digest.hexdigest()

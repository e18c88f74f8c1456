"""On-disk cache of arrays, keyed by a digest of their inputs.

The files are in the folder `graceful_plan` of the user's cache folder: below `XDG_CACHE_HOME` if that is set, else in
the system's default place. Arrays of missing, broken or unreadable files are computed again. If the folder cannot be
written, nothing is cached. The environment variable `GRACEFUL_PLAN_NO_CACHE` turns the cache off.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import zipfile
import zlib
from pathlib import Path

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.regular_file import open_regular

_LOG = logging.getLogger(__name__)
_OFF = "GRACEFUL_PLAN_NO_CACHE"
_BROKEN = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    AttributeError,
    TypeError,
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
    MemoryError,
)


def folder() -> Path | None:
    """Return the cache folder; None if the cache is turned off or the user has no home folder."""
    if os.environ.get(_OFF):
        return None
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):  # the XDG specification says to ignore relative paths
        return Path(given) / "graceful_plan"
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "graceful_plan" / "Cache"
    return home / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "graceful_plan"


def read(digest: str) -> Float[Array, "..."] | None:
    """Return the array cached under a digest; None if there is none or its file cannot be read."""
    place = folder()
    if place is None:
        return None
    file = place / f"{digest}.npz"
    try:
        with open_regular(file) as opened, np.load(opened, allow_pickle=False) as found:
            return np.asarray(found["values"], dtype=np.float64)
    except FileNotFoundError:
        return None
    except _BROKEN as error:
        _LOG.warning("%s cannot be read and is computed again: %s", file, error)
        return None


def write(digest: str, values: Float[Array, "..."]) -> None:
    """Cache an array under a digest if the folder is writable; the file appears atomically."""
    place = folder()
    if place is None:
        return
    scratch: Path | None = None
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=place, suffix=".part", delete=False) as file:
            scratch = Path(file.name)
            np.savez(file, values=values)
        os.replace(scratch, place / f"{digest}.npz")
    except OSError as error:
        _LOG.info("nothing can be cached in %s: %s", place, error)
        if scratch is not None:
            scratch.unlink(missing_ok=True)

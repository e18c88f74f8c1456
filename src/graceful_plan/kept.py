"""Arrays that are kept from one process to the next, by a digest of what they were computed from.

They are in the folder `graceful_plan` of the user's caches: below `XDG_CACHE_HOME` if that is set, else where the
system has it. Nothing else depends on them: a file that is missing, broken or not readable is computed again, and where
nothing can be written nothing is kept. With the environment variable `GRACEFUL_PLAN_NO_CACHE` set, nothing is read or
written.
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

from graceful_plan.array_types import Float
from graceful_plan.regular_file import open_regular

Array = np.ndarray

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
    """Return where arrays are kept; None if that is switched off or there is no such place."""
    if os.environ.get(_OFF):
        return None
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):  # the specification says to ignore others
        return Path(given) / "graceful_plan"
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "graceful_plan" / "Cache"
    return home / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "graceful_plan"


def read(digest: str) -> Float[Array, "..."] | None:
    """Return what was written under a digest; None if nothing was, or it cannot be read."""
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
        _LOG.warning("%s cannot be read and is made again: %s", file, error)
        return None


def write(digest: str, values: Float[Array, "..."]) -> None:
    """Keep an array under a digest, if that is possible; others see the whole file or none."""
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
        _LOG.info("nothing can be kept in %s: %s", place, error)
        if scratch is not None:
            scratch.unlink(missing_ok=True)

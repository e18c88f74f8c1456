"""Distinct paths: those of different homotopy classes or postures, not variants of one motion."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import evenly

APART = 0.3
"""Least distance of two distinct paths [rad or m]; it moves the tool by about 15 cm."""
_POINTS = 33
"""Points at which two paths are compared."""


@final
class DistinctPaths:
    """Paths whose largest distance from each other, at equal shares of their lengths, is at least `APART`."""

    def __init__(self) -> None:
        self._paths: list[Float[Array, "point nq"]] = []

    def add(self, q: Float[Array, "n nq"]) -> None:
        """Add a path."""
        self._paths.append(evenly(q, _POINTS))

    def has_none_like(self, q: Float[Array, "n nq"]) -> bool:
        """Return whether a path is distinct from all that were added."""
        even = evenly(q, _POINTS)
        return all(np.linalg.norm(even - path, axis=1).max() >= APART for path in self._paths)

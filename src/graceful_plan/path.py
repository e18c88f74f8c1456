"""Paths: geometry without time."""

from __future__ import annotations

import numbers
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError

MOST_POINTS = 10_000_000
"""Maximum number of samples of a path or trajectory: about a gigabyte per array for ten joints."""


_NO_REAL_NUMBERS = "cSUmMV"
"""Kinds of NumPy types that NumPy itself would convert to numbers, complex ones without their imaginary part."""


def is_real(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number that fits a float; infinity and NaN are, True and False are not."""
    if not isinstance(value, numbers.Real) or isinstance(value, bool | np.bool_):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is a Python or NumPy integer; True and False are not."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool | np.bool_)


def plain_numbers(settings: Any) -> None:
    """Convert NumPy numbers in the fields of a frozen dataclass to Python numbers; call it first in `__post_init__`.

    Otherwise a single-precision setting would lower the precision of results, and results could not become JSON.
    """
    for field in fields(settings):
        value = getattr(settings, field.name, None)
        if (plain := _plain(value)) is not value:
            object.__setattr__(settings, field.name, plain)


def _plain(value: object) -> object:
    """Return a value with Python numbers in place of NumPy numbers; the value itself if it has none."""
    if isinstance(value, np.bool_):
        return bool(value)
    if is_whole(value):
        return value if isinstance(value, int) else int(value)
    if isinstance(value, np.floating):
        return float(value)
    if type(value) is tuple:
        items = tuple(_plain(item) for item in value)
        return value if all(a is b for a, b in zip(items, value, strict=True)) else items
    if isinstance(value, dict):
        rows = {key: _plain(item) for key, item in value.items()}
        return value if all(rows[key] is value[key] for key in rows) else rows
    return value


def real_array(name: str, value: object) -> Float[Array, "..."]:
    """Return `value` as a float64 array; non-finite numbers are allowed, and masked entries become NaN.

    Raises:
        ShapeError: If it is ragged, or holds anything but numbers.
    """
    try:
        array = value if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        if array.dtype.kind in _NO_REAL_NUMBERS:
            raise TypeError(f"not {array.dtype.name}")
        if isinstance(array, np.ma.MaskedArray):
            return np.ma.filled(array.astype(np.float64), np.nan)
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ShapeError(name, (), f"numbers in a rectangular array ({error})") from None


def finite_array(
    name: str, value: ArrayLike | float, *, ndim: int | None = None, last: int | None = None
) -> Float[Array, "..."]:
    """Return `value` as a float64 array; refuse wrong shapes and non-finite numbers.

    Args:
        name: Name of the value in messages.
        value: The value to convert.
        ndim: Required number of axes; any if None.
        last: Required length of the last axis; any if None.

    Raises:
        ShapeError: If it is ragged, holds anything but numbers, or has the wrong number of axes or last axis.
        NonFiniteError: If it holds a NaN or an infinity.
    """
    array = real_array(name, value)
    if (ndim is not None and array.ndim != ndim) or (last is not None and (array.ndim == 0 or array.shape[-1] != last)):
        axes = ["...", "n"] if ndim is None else ["n"] * ndim
        raise ShapeError(name, array.shape, f"({', '.join([*axes[:-1], str(last)] if last is not None else axes)})")
    finite = np.isfinite(array)
    if not finite.all():
        raise NonFiniteError(name, tuple(int(i) for i in np.argwhere(~finite)[0]))
    return array


@dataclass(frozen=True, slots=False, eq=False)
class Path:
    """A polyline in configuration space.

    Args:
        q: Vertices [rad or m], at least one.
    """

    q: Float[Array, "n nq"]

    def __post_init__(self) -> None:
        q = finite_array("path", self.q, ndim=2)
        if len(q) == 0:
            raise ShapeError("path", q.shape, "(n >= 1, nq)")
        q = q.copy()
        q.flags.writeable = False
        object.__setattr__(self, "q", q)

    def __repr__(self) -> str:
        return f"Path({len(self)} points of {self.q.shape[1]} joints)"

    def __len__(self) -> int:
        return len(self.q)

    @cached_property
    def segment_lengths(self) -> Float[Array, " segment"]:
        """Euclidean joint-space length of each segment [rad]."""
        return np.linalg.norm(np.diff(self.q, axis=0), axis=1)

    @property
    def length(self) -> float:
        """Euclidean joint-space length [rad]."""
        return float(self.segment_lengths.sum())

    def without_duplicates(self) -> Path:
        """Return the path without vertices that equal their predecessor."""
        keep = np.concatenate([[True], self.segment_lengths > 0.0])
        return Path(self.q[keep])

    def reversed(self) -> Path:
        """Return the path from its end to its start."""
        return Path(self.q[::-1])

    def resampled(self, step: float) -> Path:
        """Subdivide every segment evenly into pieces no longer than `step` [rad]; vertices are kept.

        Raises:
            SettingError: If the step is not above 0, or gives more than `MOST_POINTS` pieces.
        """
        if not (is_real(step) and step > 0.0 and self.length < MOST_POINTS * step):
            raise SettingError("step", step, f"a length above 0 that gives at most {MOST_POINTS} pieces")
        pieces = np.maximum(1, np.ceil(self.segment_lengths / step).astype(int))
        parts = [
            a + np.arange(k)[:, None] / k * (b - a) for a, b, k in zip(self.q[:-1], self.q[1:], pieces, strict=True)
        ]
        return Path(np.concatenate([*parts, self.q[-1:]]))


def evenly(q: Float[Array, "vertex nq"], points: int) -> Float[Array, "point nq"]:
    """Return points at equal distances along a polyline, including both ends; corners between points are cut."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    s = np.linspace(0.0, arc[-1], points)
    return np.stack([np.interp(s, arc, q[:, joint]) for joint in range(q.shape[1])], axis=1)

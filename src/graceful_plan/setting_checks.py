"""Range checks of settings.

Each returns the setting as a Python number, or raises SettingError with its name, its value and what it has to be.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real, is_whole

MOST = 2**31 - 1
"""Largest integer of the core."""


def positive(name: str, value: object, expected: str = "a finite number > 0") -> float:
    """Check that a setting is finite and above 0."""
    if not (is_real(value) and 0.0 < value < math.inf):
        raise SettingError(name, value, expected)
    return float(value)


def positive_or_none(name: str, value: object, expected: str = "a finite number > 0") -> None:
    """Check that a setting is finite and above 0, or None."""
    if value is not None:
        positive(name, value, expected)


def not_negative(name: str, value: object, expected: str = "a finite number >= 0") -> float:
    """Check that a setting is finite and at least 0."""
    if not (is_real(value) and 0.0 <= value < math.inf):
        raise SettingError(name, value, expected)
    return float(value)


def finite(name: str, value: object, expected: str = "a finite number") -> float:
    """Check that a setting is finite."""
    if not (is_real(value) and math.isfinite(value)):
        raise SettingError(name, value, expected)
    return float(value)


def fraction(name: str, value: object, expected: str = "a number in [0, 1]") -> float:
    """Check that a setting is in [0, 1]."""
    if not (is_real(value) and 0.0 <= value <= 1.0):
        raise SettingError(name, value, expected)
    return float(value)


def positive_fraction(name: str, value: object, expected: str = "a number in (0, 1]") -> float:
    """Check that a setting is in (0, 1]."""
    if not (is_real(value) and 0.0 < value <= 1.0):
        raise SettingError(name, value, expected)
    return float(value)


def count(name: str, value: object, least: int = 1, most: int = MOST) -> None:
    """Check that a setting is an integer from `least` to `most`."""
    if not is_whole(value) or value < least:
        raise SettingError(name, value, f"an integer >= {least}")
    if value > most:
        raise SettingError(name, value, f"an integer <= {most}")


def check_ranges(values: Mapping[str, float], *, positive: Collection[str], not_negative: Collection[str]) -> None:
    """Check that constants are finite and within their ranges.

    Raises:
        SettingError: For the first constant that is not.
    """
    for name, value in values.items():
        finite(name, value)
        if name in positive and value <= 0.0:
            raise SettingError(name, value, "a positive number")
        if name in not_negative and value < 0.0:
            raise SettingError(name, value, "at least 0")
